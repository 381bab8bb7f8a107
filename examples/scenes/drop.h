/* drop - a toy bear falls on the floor, headlong. Throw it; cut it. */
#ifndef SFEM_EXAMPLES_SCENES_DROP_H
#define SFEM_EXAMPLES_SCENES_DROP_H

#ifndef SFEM_NO_CONTACT
#include "shapes.h"

SC_STATIC sfem_status sc_drop_create(sc_world *w, sfem_error *err)
{
    const double a = SC_PI / 180 * sc_value(w, "tilt", 60), at[3] = {-0.8 * sin(a), 0, sc_value(w, "height", 0.6) + 0.5};
    const double tilt[9] = {cos(a), 0, sin(a), 0, 1, 0, -sin(a), 0, cos(a)};
    const sfem_damage_def damage = sc_damage_def(w);
    sfem_body_def def;
    SC_TRY(sc_mesh_of(w, err));
    SC_TRY(sc_make_model(w, err));
    def = sc_body_def(w);
    def.damage = &damage;
    sc_look_at(w, -0.8, 0.8, -0.4, 0.4, 0, 1);
    SC_TRY(sc_add_body(w, &def, NULL, 5, err));
    SC_TRY(sfem_body_place(w->item[0].body, tilt, at, err));
    return sc_touch_floor(w, 0, err);
}

static const sc_scene sc_scene_drop = {
    "drop", "Drop", "It falls on the floor. Take hold of it and throw it, or poke it with the ball.",
    {SC_YOUNG(1e5), SC_POISSON(0.4), SC_DENSITY(1000), SC_DAMPING(0.5), SC_GRAVITY(9.81), SC_FRICTION(0.5), SC_RESTITUTION(0),
     {"height", "m", 0.1, 3, 0.6, 0, SC_AGAIN}, {"tilt", "deg", -180, 180, 60, 0, SC_AGAIN}, SC_TETS(1500), SC_STEP(1000 / 120.0),
     SC_ACCURACY(1e-4)},
    sc_drop_create, NULL, &sc_shape_bear};

#endif
#endif
