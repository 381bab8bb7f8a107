/* modes - nine free bears, each in one of the lowest modes. One may take hold of them. */
#ifndef SFEM_EXAMPLES_SCENES_MODES_H
#define SFEM_EXAMPLES_SCENES_MODES_H

#ifndef SFEM_NO_MODES
#include "shapes.h"

enum { SC_ZOO = 9 };

/* The reduced model of the lowest modes, and how far each moves a node at most with q = 1. */
SC_STATIC sfem_status sc_modes_reduce(sc_world *w, double reach[SC_ZOO], sfem_error *err)
{
    sfem_modes_def def = sfem_default_modes_def();
    sfem_reduced_def reduced_def = sfem_default_reduced_def();
    double ratio[SC_ZOO];
    sfem_modes modes;
    sfem_status status;
    sfem_int i;
    int k;
    def.modes = SC_ZOO;
    def.tolerance = 1e-8;
    SC_TRY(sfem_modes_create(w->model, &def, &modes, err));
    for (k = 0; k < SC_ZOO; ++k) ratio[k] = 0.01 * sc_value(w, "ratio", 0);
    reduced_def.ratio = ratio;
    status = sfem_reduced_create(w->model, &modes, &reduced_def, &w->reduced, err);
    sfem_modes_free(&modes);
    if (status != SFEM_OK) return status;
    for (k = 0; k < SC_ZOO; ++k) reach[k] = 0;
    for (i = 0; i < w->mesh.nodes; ++i) {
        double phi[3 * SC_ZOO], psi[3 * SC_ZOO];
        sfem_reduced_node_modes(w->reduced, i, phi, psi);
        for (k = 0; k < SC_ZOO; ++k)
            reach[k] = fmax(reach[k], hypot(hypot(phi[k], phi[SC_ZOO + k]), phi[2 * SC_ZOO + k]));
    }
    for (i = 0; i < w->mesh.nodes; ++i) w->group[i] = i;
    return sfem_reduced_view_create(w->reduced, w->mesh.nodes, w->group, SFEM_DOUBLE, &w->view, err);
}

SC_STATIC sfem_status sc_modes_create(sc_world *w, sfem_error *err)
{
    sfem_modal_def def = sfem_default_modal_def();
    double reach[SC_ZOO];
    int k;
    SC_TRY(sc_mesh_of(w, err));
    SC_TRY(sc_make_model(w, err));
    SC_TRY(sc_modes_reduce(w, reach, err));
    def.max_handle_nodes = SC_PATCH;
    for (k = 0; k < SC_ZOO; ++k) {
        const double q = sc_value(w, "amplitude", 0.1) / reach[k];
        double coordinates[SC_ZOO] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
        sc_item *item = w->item + k;
        sfem_rigid rigid;
        SC_TRY(sfem_modal_create(w->reduced, &def, &item->modal, err));
        ++w->items;
        item->color = k;
        item->at[0] = 1.1 * (k % 3 - 1);
        item->at[2] = 1.2 * (2 - k / 3);
        rigid = sfem_modal_rigid(item->modal);
        rigid.x[0] += item->at[0];
        rigid.x[2] += item->at[2];
        SC_TRY(sfem_modal_set_rigid(item->modal, &rigid, err));
        coordinates[k] = q;
        SC_TRY(sfem_modal_set_coordinates(item->modal, coordinates, NULL, NULL, err));
    }
    sc_look_at(w, -1.6, 1.6, -0.3, 0.3, 0, 3.4);
    w->speed = 0.25;
    return SFEM_OK;
}

static const sc_scene sc_scene_modes = {
    "modes", "Modal zoo", "Nine bears, each in a mode of its own. Pull at one.",
    {SC_YOUNG(1e5), SC_POISSON(0.3), SC_DENSITY(1000), {"ratio", "%", 0, 50, 0, 0, SC_AGAIN},
     {"amplitude", "m", 0, 0.3, 0.12, 0, SC_AGAIN}, SC_TETS(1500), SC_STEP(4)},
    sc_modes_create, NULL, &sc_shape_bear};

#endif
#endif
