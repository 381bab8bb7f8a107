/* grab - a toy bear stands on its feet. Pull it; cut it. */
#ifndef SFEM_EXAMPLES_SCENES_GRAB_H
#define SFEM_EXAMPLES_SCENES_GRAB_H

#include "shapes.h"

SC_STATIC sfem_status sc_grab_create(sc_world *w, sfem_error *err)
{
    const sfem_damage_def damage = sc_damage_def(w);
    sfem_body_def def;
    SC_TRY(sc_mesh_of(w, err));
    SC_TRY(sc_make_model(w, err));
    sc_select(w, 2, -1, 0.02, w->pin, &w->pins);
    def = sc_body_def(w);
    def.damage = &damage;
    sc_look_at(w, -0.5, 0.5, -0.25, 0.25, 0, 1);
    SC_TRY(sc_add_body(w, &def, NULL, 0, err));
    return sc_touch_floor(w, 0, err);
}

static const sc_scene sc_scene_grab = {
    "grab", "Grab", "Take hold of the bear and pull, or poke it with the ball.",
    {SC_YOUNG(4e5), SC_POISSON(0.4), SC_DENSITY(1000), SC_DAMPING(1), SC_GRAVITY(9.81), SC_TETS(2500), SC_STEP(1000 / 60.0),
     SC_ACCURACY(1e-6)},
    sc_grab_create, NULL, &sc_shape_bear};

#endif
