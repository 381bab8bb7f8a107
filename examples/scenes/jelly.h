/* jelly - up to twelve jellies of one model on a plate that shakes. */
#ifndef SFEM_EXAMPLES_SCENES_JELLY_H
#define SFEM_EXAMPLES_SCENES_JELLY_H

#include "shapes.h"

SC_STATIC sfem_status sc_jelly_create(sc_world *w, sfem_error *err)
{
    const int count = (int)sc_value(w, "jellies", 1), across = count < 2 ? 1 : count < 5 ? 2 : count < 10 ? 3 : 4;
    const int deep = (count + across - 1) / across;
    const sfem_damage_def damage = sc_damage_def(w);
    sfem_body_def def;
    int k;
    SC_TRY(sc_mesh_of(w, err));
    SC_TRY(sc_make_model(w, err));
    sc_select(w, 2, -1, 0.012, w->pin, &w->pins);
    def = sc_body_def(w);
    def.damage = &damage;
    for (k = 0; k < count; ++k) {
        const double at[3] = {0.55 * (k % across - 0.5 * (across - 1)), 0.55 * (k / across - 0.5 * (deep - 1)), 0};
        SC_TRY(sc_add_body(w, &def, at, k, err));
    }
    sc_look_at(w, -0.3 * across, 0.3 * across, -0.3 * deep, 0.3 * deep, 0, 0.25);
    return sc_touch_floor(w, 0, err);
}

/* The plate is at amplitude sin(2 pi f t) along x; its swing begins within half a second. */
SC_STATIC sfem_status sc_jelly_drive(sc_world *w, sfem_error *err)
{
    const double t = w->time + sc_step_length(w), from = w->way;
    const double shake = 1e-3 * sc_value(w, "shake", 0) * fmin(1, t / 0.5);
    sfem_int i;
    int k;
    w->way = shake * sin(2 * SC_PI * sc_value(w, "frequency", 3) * t);
    if (!(fabs(w->way - from) > 0)) return SFEM_OK;
    for (k = 0; k < w->items; ++k)
        for (i = 0; i < w->pins; ++i) {
            const double *x = w->mesh.x + 3 * (size_t)w->pin[i], *at = w->item[k].at;
            const double to[3] = {x[0] + at[0] + w->way, x[1] + at[1], x[2] + at[2]};
            SC_TRY(sfem_body_move_pin(w->item[k].body, w->pin[i], to, err));
        }
    return SFEM_OK;
}

static const sc_scene sc_scene_jelly = {
    "jelly", "Jelly", "Shake the plate with the sliders, or pull at a jelly.",
    {SC_YOUNG(8e3), SC_POISSON(0.45), SC_DENSITY(1000), SC_DAMPING(1), SC_GRAVITY(9.81), SC_TETS(1200),
     {"jellies", "", 1, 12, 4, 0, SC_AGAIN}, {"shake", "mm", 0, 60, 15, 0, SC_LIVE}, {"frequency", "Hz", 0.5, 10, 2.5, 0, SC_LIVE},
     SC_STEP(1000 / 60.0), SC_ACCURACY(1e-6)},
    sc_jelly_create, sc_jelly_drive, &sc_shape_jelly};

#endif
