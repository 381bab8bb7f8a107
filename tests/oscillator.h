/* A body of one degree of freedom, for the tests of what steps through time. */
#ifndef OSCILLATOR_H
#define OSCILLATOR_H

#include "support.h"
#include "linear.h"

/* One tet of which node 1 may move along x only: k u + d u' + m u'' = F with the entries of K, D, M. */
typedef struct oscillator {
    sfem_model *model;
    double k, m;
} oscillator;

static inline oscillator make_oscillator(double young, sfem_mass mass)
{
    static sfem_real x[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
    static sfem_int tet[4] = {0, 1, 2, 3};
    sfem_model_def def = linear_model_def();
    oscillator o;
    sfem_mesh mesh;
    sfem_error err;
    sfem_matrix m;
    memset(&mesh, 0, sizeof mesh);
    mesh.nodes = 4;
    mesh.tets = 1;
    mesh.x = x;
    mesh.tet = tet;
    def.mesh = &mesh;
    def.material.young = young;
    def.mass = mass;
    assert_ok(sfem_model_create(&def, &o.model, &err), err);
    assert_ok(sfem_model_combine(o.model, 0, 1, 0, NULL, &m, &err), err);
    o.k = sfem_model_stiffness(o.model)->val[9 * 2]; /* block (1,1), row-wise the third */
    o.m = m.val[9 * 2];
    sfem_matrix_free(&m);
    return o;
}

static inline sfem_body *make_body(sfem_model *model, const sfem_body_def *def)
{
    sfem_body *body = NULL;
    sfem_error err;
    assert_ok(sfem_body_create(model, def, &body, &err), err);
    return body;
}

static const sfem_int corner_pins[4] = {0, 2, 3, 1};
static const unsigned char corner_axes[4] = {7, 7, 7, SFEM_AXIS_Y | SFEM_AXIS_Z};

static inline sfem_body *oscillator_body(const oscillator *o, sfem_body_def def)
{
    def.pins = corner_pins;
    def.pin_axes = corner_axes;
    def.pin_count = 4;
    return make_body(o->model, &def);
}

static inline void set_node1(sfem_body *body, double u, double v)
{
    sfem_real uu[12] = {0}, vv[12] = {0};
    sfem_error err;
    uu[3] = u;
    vv[3] = v;
    assert_ok(sfem_body_set_state(body, uu, vv, &err), err);
}

static inline double node1(const sfem_body *body) { return sfem_body_displacement(body)[3]; }

static inline double node1_velocity(const sfem_body *body)
{
    sfem_real v[12];
    sfem_body_velocities(body, v);
    return v[3];
}

static inline void step(sfem_body *body, double h)
{
    sfem_error err;
    assert_ok(sfem_body_step(body, h, &err), err);
}

static inline void solve_dense(double *a, double *x, int n)
{
    int i, j, k;
    for (i = 0; i < n; ++i) {
        for (k = i, j = i + 1; j < n; ++j)
            if (fabs(a[j * n + i]) > fabs(a[k * n + i])) k = j;
        for (j = 0; j < n; ++j) {
            const double t = a[i * n + j];
            a[i * n + j] = a[k * n + j];
            a[k * n + j] = t;
        }
        {
            const double t = x[i];
            x[i] = x[k];
            x[k] = t;
        }
        for (j = i + 1; j < n; ++j) {
            const double f = a[j * n + i] / a[i * n + i];
            for (k = i; k < n; ++k) a[j * n + k] -= f * a[i * n + k];
            x[j] -= f * x[i];
        }
    }
    for (i = n - 1; i >= 0; --i) {
        for (k = i + 1; k < n; ++k) x[i] -= a[i * n + k] * x[k];
        x[i] /= a[i * n + i];
    }
}

#endif
