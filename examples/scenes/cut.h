/* cut - a soft bar held at both ends, to be cut. With `blade` > 0 a blade falls through its middle after so many s. */
#ifndef SFEM_EXAMPLES_SCENES_CUT_H
#define SFEM_EXAMPLES_SCENES_CUT_H

#include "shapes.h"

SC_STATIC sfem_status sc_cut_create(sc_world *w, sfem_error *err)
{
    const double fine = pow(sc_value(w, "tets", 2400) / 2400, 1 / 3.0);
    const double size[3] = {1.2, 0.25, 0.25};
    const sfem_int across = (sfem_int)fmax(2, floor(5 * fine + 0.5));
    const sfem_int cells[3] = {(sfem_int)fmax(4, floor(19 * fine + 0.5)), across, across};
    const sfem_damage_def damage = sc_damage_def(w);
    sfem_body_def def;
    SC_TRY(sc_block(w, cells, size, 0.006 / fine, err));
    SC_TRY(sc_make_model(w, err));
    sc_select(w, 0, -1, 1e-9, w->pin, &w->pins);
    sc_select(w, 0, size[0] - 1e-9, 2, w->pin, &w->pins);
    def = sc_body_def(w);
    def.damage = &damage;
    sc_look_at(w, 0, size[0], 0, size[1], -0.3, size[2]);
    SC_TRY(sc_add_body(w, &def, NULL, 1, err));
    return sc_touch_floor(w, -0.4, err);
}

SC_STATIC sfem_status sc_cut_drive(sc_world *w, sfem_error *err)
{
    const double when = sc_value(w, "blade", 0);
    const double from[6] = {0.6, -1, 1, 0.6, 2, 1}, to[6] = {0.6, -1, -2, 0.6, 2, -2};
    int marked;
    if (w->phase || !(when > 0) || w->time < when) return SFEM_OK;
    w->phase = 1;
    return sc_cut(w, from, to, &marked, err);
}

static const sc_scene sc_scene_cut = {
    "cut", "Cut", "Choose Cut, and swipe across the bar. Cut it again.",
    {SC_YOUNG(1e5), SC_POISSON(0.35), SC_DENSITY(1000), SC_DAMPING(1), SC_GRAVITY(9.81), SC_TETS(2400),
     {"blade", "s", 0, 10, 0, 0, SC_AGAIN}, SC_STEP(1000 / 60.0), SC_ACCURACY(1e-6)},
    sc_cut_create, sc_cut_drive, NULL};

#endif
