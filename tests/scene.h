/* scene.h - a bar of a nonlinear law, its motions, and what is measured of them. For tests of the safeguarded and
 * the corrected step. Include it in place of support.h.
 */
#ifndef SFEM_TESTS_SCENE_H
#define SFEM_TESTS_SCENE_H

#include "support.h"
#include "linear.h"
#include "blocks.h"

/* --------------------------------------------------------------------------------------------
 * scenes
 * -------------------------------------------------------------------------------------------- */

enum { MAX_NODES = 400 };

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_int pins[64], n; /* the face at x = 0; nodes */
    sfem_int pin_count;
    double centre[3];
} scene;

TEST_STATIC sfem_material rubber(double young)
{
    sfem_material m = linear_material();
    m.young = young;
    m.law = SFEM_COROTATIONAL;
    return m;
}

/* The model of a bar along x, its nodes moved a little so that no symmetry hides a mistake. */
TEST_STATIC scene bar(sfem_int nx, sfem_int ny, sfem_material material)
{
    const sfem_int cells[3] = {nx, ny, ny};
    const sfem_real size[3] = {0.1 * nx, 0.1 * ny, 0.1 * ny};
    sfem_model_def def = linear_model_def();
    uint64_t random = 11;
    sfem_error err;
    int i;
    scene s;
    memset(&s, 0, sizeof s);
    assert_ok(block_mesh(cells, size, 0.01, &random, &s.mesh, &err), err);
    s.pin_count = block_clamp(cells, s.pins);
    for (i = 0; i < 3; ++i) s.centre[i] = size[i] / 2;
    s.n = s.mesh.nodes;
    assert_true(s.n <= MAX_NODES);
    def.mesh = &s.mesh;
    def.material = material;
    assert_ok(sfem_model_create(&def, &s.model, &err), err);
    return s;
}

TEST_STATIC void add_body(scene *s, sfem_body_def def, int held)
{
    sfem_error err;
    if (held) {
        def.pins = s->pins;
        def.pin_count = s->pin_count;
    }
    assert_ok(sfem_body_create(s->model, &def, &s->body, &err), err);
}

TEST_STATIC void drop(scene *s)
{
    sfem_body_free(s->body);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
    memset(s, 0, sizeof *s);
}

TEST_STATIC void step(sfem_body *body, double h)
{
    sfem_error err;
    assert_ok(sfem_body_step(body, h, &err), err);
}

TEST_STATIC void run(sfem_body *body, double h, int steps)
{
    while (steps-- > 0) step(body, h);
}

TEST_STATIC void cross(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

TEST_STATIC double length(const double *a, size_t n)
{
    double sum = 0;
    size_t i;
    for (i = 0; i < n; ++i) sum += a[i] * a[i];
    return sqrt(sum);
}

/* v = velocity + spin x (X - centre) */
TEST_STATIC void rigid_velocity(const scene *s, const double *velocity, const double *spin,
                                double *v)
{
    sfem_int i;
    int c;
    for (i = 0; i < s->n; ++i) {
        double r[3];
        for (c = 0; c < 3; ++c) r[c] = s->mesh.x[3 * i + c] - s->centre[c];
        cross(spin, r, v + 3 * i);
        for (c = 0; c < 3; ++c) v[3 * i + c] += velocity[c];
    }
}

TEST_STATIC void set_motion(scene *s, const double *velocity, const double *spin)
{
    double v[3 * MAX_NODES];
    sfem_error err;
    rigid_velocity(s, velocity, spin, v);
    assert_ok(sfem_body_set_state(s->body, NULL, v, &err), err);
}

static const double zero3[3] = {0, 0, 0};

/* A random proper rotation. */
TEST_STATIC void random_rotation(uint64_t seed, double r[9])
{
    test_random random = {seed};
    double f[9];
    int i;
    for (i = 0; i < 9; ++i) f[i] = random_normal(&random);
    sfem_polar(f, r, NULL);
}

TEST_STATIC void turn(const double *r, const double *x, size_t nodes, double *y)
{
    size_t i;
    int c;
    for (i = 0; i < nodes; ++i) {
        const double a = x[3 * i], b = x[3 * i + 1], d = x[3 * i + 2];
        for (c = 0; c < 3; ++c)
            y[3 * i + (size_t)c] = r[3 * c] * a + r[3 * c + 1] * b + r[3 * c + 2] * d;
    }
}

/* Elastic energy and forces by themselves. */
TEST_STATIC double forces(const scene *s, const double *u, double *f)
{
    double *work = (double *)malloc(sfem_model_work_size(s->model) * sizeof *work), psi;
    psi = sfem_model_forces(s->model, u, SFEM_DOUBLE, f, NULL, NULL, work, NULL);
    free(work);
    return psi;
}

/* P and L of the mean velocity over the last step, from positions before and after. */
TEST_STATIC void momentum(const scene *s, const double *u0, const double *u1, double h, double p[3],
                          double l[3])
{
    const double *mass = sfem_model_node_mass(s->model);
    sfem_int i;
    int c;
    memset(p, 0, 3 * sizeof *p);
    memset(l, 0, 3 * sizeof *l);
    for (i = 0; i < s->n; ++i) {
        double x[3], w[3], t[3];
        for (c = 0; c < 3; ++c) {
            x[c] = s->mesh.x[3 * i + c] + u1[3 * i + c];
            w[c] = mass[i] * (u1[3 * i + c] - u0[3 * i + c]) / h;
            p[c] += w[c];
        }
        cross(x, w, t);
        for (c = 0; c < 3; ++c) l[c] += t[c];
    }
}

/* L about the centre of mass, of P and L about the origin, to see what becomes of the spin. */
TEST_STATIC void about_centre(const scene *s, const double p[3], double l[3])
{
    const double *mass = sfem_model_node_mass(s->model), *u = sfem_body_displacement(s->body);
    double c[3] = {0, 0, 0}, t[3];
    sfem_int i;
    int k;
    for (i = 0; i < 3 * s->n; ++i)
        c[i % 3] += mass[i / 3] * (s->mesh.x[i] + u[i]) / sfem_model_total_mass(s->model);
    cross(c, p, t);
    for (k = 0; k < 3; ++k) l[k] -= t[k];
}

TEST_STATIC void central_momentum(const scene *s, const double *before, double h, double p[3],
                                  double l[3])
{
    momentum(s, before, sfem_body_displacement(s->body), h, p, l);
    about_centre(s, p, l);
}

/* The same of the body's velocities. */
TEST_STATIC void body_momentum(const scene *s, double p[3], double l[3])
{
    double u[3 * MAX_NODES], v[3 * MAX_NODES];
    sfem_int i;
    sfem_body_velocities(s->body, v);
    for (i = 0; i < 3 * s->n; ++i) u[i] = sfem_body_displacement(s->body)[i] - v[i];
    central_momentum(s, u, 1, p, l);
}

TEST_STATIC void distance3(const double *a, const double *b, double *out)
{
    int c;
    for (*out = 0, c = 0; c < 3; ++c) *out += (a[c] - b[c]) * (a[c] - b[c]);
    *out = sqrt(*out);
}

#endif
