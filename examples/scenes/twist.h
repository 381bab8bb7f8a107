/* twist - a bar, 1 x 0.2 x 0.2 m, is twisted at one end, held for a moment, and let go. */
#ifndef SFEM_EXAMPLES_SCENES_TWIST_H
#define SFEM_EXAMPLES_SCENES_TWIST_H

#include "shapes.h"

SC_STATIC sfem_status sc_twist_create(sc_world *w, sfem_error *err)
{
    static const double size[3] = {1, 0.2, 0.2};
    const double fine = pow(sc_value(w, "tets", 2500) / 2500, 1 / 3.0);
    const sfem_int across = (sfem_int)fmax(2, floor(5 * fine)), cells[3] = {(sfem_int)floor(20 * fine), across, across};
    sfem_damage_def damage = sc_damage_def(w);
    sfem_body_def def;
    SC_TRY(sc_block(w, cells, size, 0, err));
    SC_TRY(sc_make_model(w, err));
    sc_select(w, 0, -1, 1e-9, w->pin, &w->pins);
    sc_select(w, 0, 1 - 1e-9, 2, w->group, &w->group_count);
    memcpy(w->pin + w->pins, w->group, (size_t)w->group_count * sizeof *w->pin);
    w->pins += w->group_count;
    def = sc_body_def(w);
    def.damage = &damage;
    sc_look_at(w, 0, 1, 0, 0.2, -0.15, 0.35);
    return sc_add_body(w, &def, NULL, 3, err);
}

SC_STATIC sfem_status sc_twist_drive(sc_world *w, sfem_error *err)
{
    const double turns = sc_value(w, "turns", 1), rate = sc_value(w, "rate", 0.5), before = w->way;
    double c, s;
    sfem_int i;
    if (w->phase) return SFEM_OK;
    if (w->time > turns / rate + 0.5) {
        w->phase = 1;
        w->pins -= w->group_count;
        return sfem_body_set_pins(w->item[0].body, w->pins, w->pin, NULL, err);
    }
    w->way = fmin(turns, w->way + rate * sc_step_length(w));
    if (!(w->way > before)) return SFEM_OK;
    c = cos(2 * SC_PI * w->way);
    s = sin(2 * SC_PI * w->way);
    for (i = 0; i < w->group_count; ++i) {
        const double *x = w->mesh.x + 3 * (size_t)w->group[i], y = x[1] - 0.1, z = x[2] - 0.1;
        const double to[3] = {x[0], 0.1 + c * y - s * z, 0.1 + s * y + c * z};
        SC_TRY(sfem_body_move_pin(w->item[0].body, w->group[i], to, err));
    }
    return SFEM_OK;
}

static const sc_scene sc_scene_twist = {
    "twist", "Twist", "It is twisted, and let go.",
    {SC_YOUNG(3e5), SC_POISSON(0.3), SC_DENSITY(1000), SC_DAMPING(0.5), SC_GRAVITY(0), {"turns", "", 0.25, 3, 1, 0, SC_AGAIN},
     {"rate", "1/s", 0.1, 2, 0.5, 0, SC_AGAIN}, SC_TETS(2500), SC_STEP(1000 / 60.0), SC_ACCURACY(1e-6)},
    sc_twist_create, sc_twist_drive, NULL};

#endif
