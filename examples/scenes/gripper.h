/* gripper - two fingers squeeze a soft fruit, lift it, and hold it; with too little friction it slips out.
 *
 * The fingers are boxes that the driver moves, as a robot's controller would: together until each feels the grip that
 * was asked for, then up, then still. w->phase is 1 from the moment when that was felt. Obstacle 0 is the table.
 */
#ifndef SFEM_EXAMPLES_SCENES_GRIPPER_H
#define SFEM_EXAMPLES_SCENES_GRIPPER_H

#ifndef SFEM_NO_CONTACT
#include "shapes.h"

enum { SC_FINGER = 1 }; /* the obstacles 1 and 2, that at +x first */
/* s: the fingers close until then at the latest; they go up from LIFT to HOLD */
#define SC_CLOSE 1.0
#define SC_LIFT 1.3
#define SC_HOLD 2.1
#define SC_RISE 0.08 /* m */

SC_STATIC sfem_status sc_gripper_create(sc_world *w, sfem_error *err)
{
    static const double finger[3] = {0.008, 0.03, 0.035}; /* m, half of its sides */
    const sfem_damage_def damage = sc_damage_def(w);
    sfem_obstacle_def box = sfem_default_obstacle_def();
    double low = 0, high = 0;
    sfem_body_def def;
    sfem_int i;
    int k;
    SC_TRY(sc_mesh_of(w, err));
    SC_TRY(sc_make_model(w, err));
    def = sc_body_def(w);
    def.refactorise = 0;
    def.stiffness_damping = 0.004;
    def.damage = &damage;
    sc_look_at(w, -0.07, 0.07, -0.05, 0.05, 0, 0.16);
    SC_TRY(sc_add_body(w, &def, NULL, 0, err));
    SC_TRY(sc_touch_floor(w, 0, err));
    for (i = 0; i < w->mesh.nodes; ++i) {
        low = fmin(low, w->mesh.x[3 * (size_t)i]);
        high = fmax(high, w->mesh.x[3 * (size_t)i]);
    }
    box.kind = SFEM_OBSTACLE_BOX;
    memcpy(box.size, finger, sizeof finger);
    for (k = 0; k < 2; ++k) {
        box.position[0] = (k ? -1 : 1) * ((high - low) / 2 + finger[0] + 0.004);
        box.position[2] = 0.04;
        SC_TRY(sc_add_obstacle(w, &box, err));
    }
    return SFEM_OK;
}

/* N, of the body at g = 9.81 m/s^2 */
SC_STATIC double sc_weight(const sc_world *w)
{
    const double *mass = sfem_model_node_mass(w->model);
    double sum = 0;
    sfem_int i;
    for (i = 0; i < w->mesh.nodes; ++i) sum += mass[i];
    return 9.81 * sum;
}

/* N: what the fingers feel, each inwards */
SC_STATIC double sc_grip_felt(const sc_world *w)
{
    double force[2][3];
    int k;
    for (k = 0; k < 2; ++k) sc_obstacle_force(w, SC_FINGER + k, force[k]);
    return (force[0][0] - force[1][0]) / 2;
}

SC_STATIC sfem_status sc_gripper_drive(sc_world *w, sfem_error *err)
{
    const double speed = 0.03, s = (w->time - SC_LIFT) / (SC_HOLD - SC_LIFT);
    double v[3] = {0, 0, 0};
    int k;
    if (w->steps && sc_grip_felt(w) >= sc_value(w, "grip", 1.2) * sc_weight(w)) w->phase = 1;
    if (s > 0 && s < 1) v[2] = SC_RISE * 6 * s * (1 - s) / (SC_HOLD - SC_LIFT);
    for (k = 0; k < 2; ++k) {
        v[0] = w->phase == 0 && w->time < SC_CLOSE ? (k ? speed : -speed) : 0;
        SC_TRY(sc_move_obstacle(w, SC_FINGER + k, v, err));
    }
    return SFEM_OK;
}

static const sc_scene sc_scene_gripper = {
    "gripper", "Gripper", "Two fingers lift a fruit. With how little friction does it slip out?",
    {SC_YOUNG(5e4), SC_POISSON(0.42), SC_DENSITY(1000), SC_DAMPING(0), SC_GRAVITY(9.81), SC_FRICTION(0.8), SC_RESTITUTION(0),
     {"grip", "weights", 0.5, 5, 1.2, 0, SC_AGAIN}, SC_TETS(2500), SC_STEP(1000 / 120.0), SC_ACCURACY(1e-6)},
    sc_gripper_create, sc_gripper_drive, &sc_shape_fruit};

#endif
#endif
