/* shapes.h - what scenes are made of: signed distances of a toy bear, a jelly and a fruit. Include after scene.h. */
#ifndef SFEM_EXAMPLES_SHAPES_H
#define SFEM_EXAMPLES_SHAPES_H

#include "scene.h"

SC_STATIC double sc_clamp(double x, double low, double high) { return fmax(low, fmin(high, x)); }

SC_STATIC double sc_blend(double a, double b, double width) /* smooth minimum */
{
    const double t = sc_clamp(0.5 + 0.5 * (b - a) / width, 0, 1);
    return b + t * (a - b) - width * t * (1 - t);
}

SC_STATIC double sc_ellipsoid(const double *x, const double c[3], const double r[3])
{
    double k0 = 0, k1 = 0;
    int k;
    for (k = 0; k < 3; ++k) {
        const double d = (x[k] - c[k]) / r[k];
        k0 += d * d;
        k1 += d * d / (r[k] * r[k]);
    }
    return k1 > 0 ? sqrt(k0) * (sqrt(k0) - 1) / sqrt(k1) : -r[0];
}

SC_STATIC double sc_capsule(const double *x, const double *a, const double *b, double radius)
{
    double dd = 0, pd = 0, q = 0, t;
    int k;
    for (k = 0; k < 3; ++k) {
        dd += (b[k] - a[k]) * (b[k] - a[k]);
        pd += (b[k] - a[k]) * (x[k] - a[k]);
    }
    t = sc_clamp(pd / dd, 0, 1);
    for (k = 0; k < 3; ++k) {
        const double d = x[k] - a[k] - t * (b[k] - a[k]);
        q += d * d;
    }
    return sqrt(q) - radius;
}

/* The bear: spheres, ellipsoids and capsules, blended; it stands on z = 0 and looks along -y. 1 m high. */
SC_STATIC sfem_real sc_bear(const sfem_real x[3], void *user)
{
    static const double belly[2][3] = {{0, 0, 0.39}, {0.215, 0.17, 0.27}}, head[2][3] = {{0, -0.02, 0.77}, {0.185, 0.17, 0.17}};
    static const double ear[2][3] = {{0.135, 0, 0.915}, {0.075, 0.055, 0.075}};
    static const double snout[2][3] = {{0, -0.18, 0.73}, {0.085, 0.065, 0.065}};
    static const double shoulder[3] = {0.16, -0.02, 0.53}, hand[3] = {0.41, -0.05, 0.53};
    static const double hip[3] = {0.11, 0, 0.17}, foot[3] = {0.15, -0.15, 0.075};
    const double y[3] = {fabs(x[0]), x[1], x[2]}; /* both sides */
    double d = sc_ellipsoid(y, belly[0], belly[1]);
    (void)user;
    d = sc_blend(d, sc_ellipsoid(y, head[0], head[1]), 0.05);
    d = sc_blend(d, sc_ellipsoid(y, ear[0], ear[1]), 0.03);
    d = sc_blend(d, sc_ellipsoid(y, snout[0], snout[1]), 0.03);
    d = sc_blend(d, sc_capsule(y, shoulder, hand, 0.078), 0.05);
    d = sc_blend(d, sc_capsule(y, hip, foot, 0.095), 0.05);
    return fmax(d, 0.004 - x[2]); /* flat soles */
}

/* A jelly out of a fluted mould with a hole in its top, 0.25 m high, on z = 0. */
SC_STATIC sfem_real sc_jelly(const sfem_real x[3], void *user)
{
    const double r = sqrt(x[0] * x[0] + x[1] * x[1]), z = x[2];
    const double lobes = r > 0.02 ? cos(10 * atan2(x[1], x[0])) : 0;
    const double side = r - (0.21 - 0.22 * z + 0.008 * lobes), top = hypot(fmax(r - 0.09, 0), z - 0.1) - 0.15;
    const double hole = 0.035 + 0.25 * fmax(z - 0.05, 0) - r;
    (void)user;
    return fmax(fmax(-sc_blend(-side, -top, 0.03), hole), 0.002 - z);
}

/* A fruit of 8 cm: a ball with lobes and a dent at the top, on z = 0. */
SC_STATIC sfem_real sc_fruit(const sfem_real x[3], void *user)
{
    const double z = x[2] - 0.04, across = sqrt(x[0] * x[0] + x[1] * x[1]), r = sqrt(across * across + z * z);
    const double flat = r > 0 ? across / r : 0, dent = 0.012 * exp(-across * across / 2e-4) * (z > 0);
    (void)user;
    return r - 0.04 * (1 + 0.04 * flat * cos(5 * atan2(x[1], x[0]))) + dent;
}

static const sc_shape sc_shape_bear = {sc_bear, {{-0.6, -0.35, 0}, {0.6, 0.3, 1.1}}};
static const sc_shape sc_shape_jelly = {sc_jelly, {{-0.3, -0.3, 0}, {0.3, 0.3, 0.3}}};
static const sc_shape sc_shape_fruit = {sc_fruit, {{-0.05, -0.05, -0.01}, {0.05, 0.05, 0.09}}};

SC_STATIC sfem_status sc_mesh_of(sc_world *w, sfem_error *err)
{
    const sc_shape *shape = w->scene->shape;
    sfem_mesher_def def = sfem_default_mesher_def();
    def.tets = (sfem_int)sc_value(w, "tets", 2500);
    if (!sc_same_mesh(w)) SC_TRY(sfem_mesh_from_sdf(&def, shape->distance, NULL, shape->box, &w->mesh, NULL, err));
    return sc_take_mesh(w, err);
}

/* Nodes with low <= x[axis] <= high join a list. */
SC_STATIC void sc_select(const sc_world *w, int axis, double low, double high, sfem_int *list, sfem_int *count)
{
    sfem_int i;
    for (i = 0; i < w->mesh.nodes; ++i) {
        const double x = w->mesh.x[3 * (size_t)i + (size_t)axis];
        if (x >= low && x <= high) list[(*count)++] = i;
    }
}

#endif
