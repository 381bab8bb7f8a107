/* shatter - a plate, 1 x 1 x 0.05 m, held at its edges; handles near its middle go down and let go. */
#ifndef SFEM_EXAMPLES_SCENES_SHATTER_H
#define SFEM_EXAMPLES_SCENES_SHATTER_H

#include "shapes.h"

SC_STATIC sfem_status sc_shatter_create(sc_world *w, sfem_error *err)
{
    static const double size[3] = {1, 1, 0.05};
    const double tets = sc_value(w, "tets", 2000), layers = tets > 5000 ? 2 : 1;
    const sfem_int n = (sfem_int)floor(sqrt(tets / (5 * layers)) + 0.5), cells[3] = {n, n, (sfem_int)layers};
    sfem_damage_def damage = sc_damage_def(w);
    sfem_body_def def;
    sfem_int i;
    SC_TRY(sc_block(w, cells, size, 0.11 / n, err));
    SC_TRY(sc_make_model(w, err));
    for (i = 0; i < w->mesh.nodes; ++i) {
        const double *x = w->mesh.x + 3 * (size_t)i;
        if (fmax(fabs(x[0] - 0.5), fabs(x[1] - 0.5)) > 0.5 - 1e-9) w->pin[w->pins++] = i;
        if (x[2] > 0.049 && hypot(x[0] - 0.5, x[1] - 0.45) < fmax(0.07, 1.0 / n) && w->group_count < SC_HANDLES - 16)
            w->group[w->group_count++] = i;
    }
    damage.weibull = 6;
    def = sc_body_def(w);
    def.refactorise = 0;
    def.damage = &damage;
    def.max_handles = SC_HANDLES;
    sc_look_at(w, 0, 1, 0, 1, -0.25, 0.2);
    w->speed = 0.08;
    SC_TRY(sc_add_body(w, &def, NULL, 4, err));
    for (i = 0; i < w->group_count; ++i, ++w->handles)
        SC_TRY(sfem_body_grab_node(w->item[0].body, w->group[i], &w->handle[i], err));
    return sc_touch_floor(w, -0.42, err);
}

SC_STATIC sfem_status sc_shatter_drive(sc_world *w, sfem_error *err)
{
    const double by = sc_value(w, "blow", 4) * sc_step_length(w);
    int k;
    w->way += by;
    for (k = 0; k < w->handles; ++k) {
        double x[3];
        if (w->way > 0.12) {
            sfem_body_release_handle(w->item[0].body, w->handle[k]);
            continue;
        }
        sfem_body_handle_position(w->item[0].body, w->handle[k], x);
        x[2] -= by;
        SC_TRY(sfem_body_move_handle(w->item[0].body, w->handle[k], x, err));
    }
    if (w->way > 0.12) w->handles = 0;
    return SFEM_OK;
}

static const sc_scene sc_scene_shatter = {
    "shatter", "Shatter", "A blow in the middle, in slow motion.",
    {SC_YOUNG(5e6), SC_POISSON(0.3), SC_DENSITY(1000), SC_DAMPING(0.5), SC_GRAVITY(9.81), SC_TOUGHNESS(250),
     {"blow", "m/s", 0, 20, 6, 0, SC_AGAIN}, SC_TETS(1500), SC_STEP(1), SC_ACCURACY(1e-3)},
    sc_shatter_create, sc_shatter_drive, NULL};

#endif
