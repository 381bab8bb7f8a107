/* tear - a toy bear, pulled by both arms until one tears off at its shoulder. */
#ifndef SFEM_EXAMPLES_SCENES_TEAR_H
#define SFEM_EXAMPLES_SCENES_TEAR_H

#include "shapes.h"

SC_STATIC sfem_status sc_tear_create(sc_world *w, sfem_error *err)
{
    sfem_damage_def damage = sc_damage_def(w);
    unsigned char *whole; /* all but the left shoulder */
    sfem_body_def def;
    sfem_status status;
    sfem_int i;
    int k;
    SC_TRY(sc_mesh_of(w, err));
    SC_TRY(sc_make_model(w, err));
    sc_select(w, 2, -1, 0.02, w->pin, &w->pins);
    sc_select(w, 0, -1, -0.42, w->group, &w->group_count);
    sc_select(w, 0, 0.42, 1, w->group, &w->group_count);
    for (i = 0; i < w->group_count; ++i) w->pin[w->pins++] = w->group[i];
    whole = (unsigned char *)calloc((size_t)w->mesh.tets, 1);
    if (!whole) return sc_fail(err, SFEM_OUT_OF_MEMORY, "out of memory");
    for (i = 0; i < w->mesh.tets; ++i) {
        double x = 0;
        for (k = 0; k < 4; ++k) x += 0.25 * w->mesh.x[3 * (size_t)w->mesh.tet[4 * i + k]];
        whole[i] = x < -0.31 || x > -0.2;
    }
    damage.weibull = 8;
    damage.unbreakable = whole;
    def = sc_body_def(w);
    def.damage = &damage;
    sc_look_at(w, -0.6, 0.6, -0.25, 0.25, 0, 1);
    w->speed = 0.5;
    status = sc_add_body(w, &def, NULL, 2, err);
    free(whole);
    return status == SFEM_OK ? sc_touch_floor(w, 0, err) : status;
}

/* The hands go apart and up until something has come off. */
SC_STATIC sfem_status sc_tear_drive(sc_world *w, sfem_error *err)
{
    sfem_int i;
    w->phase = sfem_body_fracture(w->item[0].body).pieces > 1;
    if (w->phase || w->way > 0.8) return SFEM_OK;
    w->way += sc_value(w, "pull", 0.6) * sc_step_length(w);
    for (i = 0; i < w->group_count; ++i) {
        const double *x = w->mesh.x + 3 * (size_t)w->group[i];
        const double to[3] = {x[0] + (x[0] > 0 ? w->way : -w->way), x[1], x[2] + 0.35 * w->way};
        SC_TRY(sfem_body_move_pin(w->item[0].body, w->group[i], to, err));
    }
    return SFEM_OK;
}

static const sc_scene sc_scene_tear = {
    "tear", "Tear", "Both arms are pulled. Which toughness holds?",
    {SC_YOUNG(1e5), SC_POISSON(0.4), SC_DENSITY(1000), SC_DAMPING(2), SC_GRAVITY(9.81), SC_TOUGHNESS(3000),
     {"pull", "m/s", 0, 3, 0.6, 0, SC_LIVE}, SC_TETS(2500), SC_STEP(8), SC_ACCURACY(1e-6)},
    sc_tear_create, sc_tear_drive, &sc_shape_bear};

#endif
