/* real.h - scenes on real and on unstructured meshes, shared by benches and tests.
 *
 *     for (k = 0; k < REAL_SCENES; ++k) real_table[k]              what there is
 *     real_there(&real_table[k])                                   is its mesh at hand?
 *     real_open(&real_table[k], law, poisson, &scene, &err)        mesh, model, pins, velocities
 *     real_body(&scene, &def, &body, &err)                         def from real_body_def(&scene)
 *     real_close(&scene)
 *
 * A body of 1000 kg/m^3, its longest axis scaled to 2 m (but where keeps_size), is held at the lower
 * 12 % of that axis, or at the face of a bar, and falls by gravity across the axis; or it is free, without gravity, and
 * spins at 6 rad/s about an axis across it. Errors are those of the 20 nodes that lie the farthest along the axis.
 * Meshes of others are read from the directory SFEM_MESHES; without it their scenes are not there.
 */
#ifndef SFEM_BENCH_REAL_H
#define SFEM_BENCH_REAL_H

#include "../tests/bodies.h"
#include "../tests/linear.h"

#define REAL_STATIC static __attribute__((unused))
#define REAL_TIPS   20

typedef struct real_def {
    const char *name;
    const char *file; /* in SFEM_MESHES; NULL: a bar or a scattered body, see cells */
    double young;     /* Pa */
    int free;         /* spins; else held */
    int good;         /* no more than 1 % of its tets are below a quality of 0.1 */
    int calm;      /* bounds on the time of the worst step hold: it bends, but does not collapse */
    int reference; /* steps of the reference in 1/30 s */
    int keeps_size;
    int cells[3];   /* of a bar, six tets each; or {tets, seed, 0} of a scattered body */
    double size[3]; /* of a bar, m; or {q_min, 0, 0} */
} real_def;

#define REAL_FILE(name, file, young, free, good, calm, reference, keeps)                           \
    {                                                                                              \
        name, file, young, free, good, calm, reference, keeps, {0, 0, 0}, { 0, 0, 0 }              \
    }
#define REAL_BAR(name, young, calm, reference, a, b, c, x, y, z)                                   \
    {                                                                                              \
        name, NULL, young, 0, 1, calm, reference, 1, {a, b, c}, { x, y, z }                        \
    }
#define REAL_BODY(name, young, free, good, calm, tets, q)                                          \
    {                                                                                              \
        name, NULL, young, free, good, calm, 16, 0, {tets, 1, 0}, { q, 0, 0 }                      \
    }

static const real_def real_table[] = {
    REAL_FILE("octopus 2e5", "igl_octopus_low.mesh", 2e5, 0, 0, 0, 32, 0),
    REAL_FILE("octopus 3e6", "igl_octopus_low.mesh", 3e6, 0, 0, 1, 32, 0),
    REAL_FILE("armadillo 2e5", "pbd_armadillo_4k.node", 2e5, 0, 1, 0, 16, 1),
    REAL_FILE("armadillo 1e6", "pbd_armadillo_4k.node", 1e6, 0, 1, 1, 16, 1),
    REAL_FILE("armadillo 3e7", "pbd_armadillo_4k.node", 3e7, 0, 1, 1, 16, 1),
    REAL_BAR("bar 1e6", 1e6, 1, 32, 20, 2, 2, 2, 0.2, 0.2),
    REAL_BAR("far bar 5k", 1e6, 1, 16, 24, 6, 6, 4, 1, 1),
    REAL_BAR("bar 20k", 1e6, 1, 8, 42, 9, 9, 2, 0.43, 0.43),
    REAL_FILE("shark 1e6", "mj_shark_ascii22.msh", 1e6, 0, 1, 1, 32, 0),
    REAL_FILE("simpleBridge 1e6", "vega_simpleBridge.veg", 1e6, 0, 1, 0, 8, 0),
    REAL_FILE("octopus free", "igl_octopus_low.mesh", 2e5, 1, 0, 1, 32, 0),
    REAL_FILE("armadillo free", "pbd_armadillo_4k.node", 1e6, 1, 1, 1, 16, 1),
    REAL_BODY("scattered soft", 2e5, 0, 1, 0, 3000, 0.1),
    REAL_BODY("scattered stiff", 1e7, 0, 1, 1, 3000, 0.1),
    REAL_BODY("scattered soft free", 2e5, 1, 1, 1, 3000, 0.1),
    REAL_BODY("scattered stiff free", 1e7, 1, 1, 1, 3000, 0.1),
    REAL_BODY("slivers soft", 2e5, 0, 0, 0, 3000, 0.01),
    REAL_BODY("slivers stiff", 1e7, 0, 0, 1, 3000, 0.01),
    REAL_BODY("slivers soft free", 2e5, 1, 0, 1, 3000, 0.01),
    REAL_BODY("slivers stiff free", 1e7, 1, 0, 1, 3000, 0.01),
};
#define REAL_SCENES (int)(sizeof real_table / sizeof *real_table)

/* Of the models that real_open makes. */
REAL_STATIC sfem_tet real_tet = SFEM_TET_LINEAR;

typedef struct real_scene {
    const real_def *def;
    sfem_mesh mesh;
    sfem_model *model;
    sfem_int *pins, pin_count;
    sfem_real *velocity; /* [nodes][3] at the start */
    sfem_real gravity[3];
    sfem_int tip[REAL_TIPS];
} real_scene;

/* The path of a scene's mesh, or NULL. */
REAL_STATIC const char *real_path(const real_def *d)
{
    static char path[1024];
    const char *directory = getenv("SFEM_MESHES");
    FILE *f;
    if (!d->file || !directory) return NULL;
    snprintf(path, sizeof path, "%s/%s", directory, d->file);
    f = fopen(path, "rb");
    if (!f) return NULL;
    fclose(f);
    return path;
}

REAL_STATIC int real_there(const real_def *d) { return !d->file || real_path(d); }

REAL_STATIC sfem_status real_mesh(const real_def *d, sfem_mesh *out, sfem_error *err)
{
    sfem_status status;
    sfem_int cells[3];
    int k;
    for (k = 0; k < 3; ++k) cells[k] = (sfem_int)d->cells[k];
    if (d->file)
        status = sfem_mesh_read(real_there(d) ? real_path(d) : d->file, NULL, out, err);
    else if (d->cells[2])
        return sfem_mesh_block(cells, d->size, SFEM_CELL_6_TETS, NULL, out, err);
    else
        return body_scattered(cells[0], d->size[0], (uint64_t)cells[1], out, err);
    if (status != SFEM_OK) return status;
    status = sfem_mesh_remove_unused(out, NULL, err);
    if (status != SFEM_OK) sfem_mesh_free(out);
    return status;
}

/* The nodes that lie the farthest along the axis, of equals the first. */
REAL_STATIC void real_tips(real_scene *s, int axis)
{
    int i, k;
    for (i = 0; i < REAL_TIPS; ++i) {
        sfem_int n, best = -1;
        for (n = 0; n < s->mesh.nodes; ++n) {
            for (k = 0; k < i && s->tip[k] != n; ++k) {
            }
            if (k == i && (best < 0 || s->mesh.x[3 * n + axis] > s->mesh.x[3 * best + axis]))
                best = n;
        }
        s->tip[i] = best;
    }
}

/* Scales the mesh, finds its longest axis, what is held, the load and the velocities. */
REAL_STATIC void real_place(real_scene *s)
{
    const real_def *d = s->def;
    double low[3], high[3], centre[3] = {0, 0, 0}, scale, limit;
    sfem_real *x = s->mesh.x;
    sfem_int i;
    int k, axis = 0, across, a, b;
    for (k = 0; k < 3; ++k) {
        low[k] = high[k] = x[k];
        for (i = 0; i < s->mesh.nodes; ++i) {
            if (x[3 * i + k] < low[k]) low[k] = x[3 * i + k];
            if (x[3 * i + k] > high[k]) high[k] = x[3 * i + k];
        }
        if (high[k] - low[k] > high[axis] - low[axis]) axis = k;
    }
    scale = d->keeps_size ? 1 : 2 / (high[axis] - low[axis]);
    limit =
        scale * (low[axis] + (!d->file && d->keeps_size ? 1e-3 : 0.12) * (high[axis] - low[axis]));
    for (i = 0; i < 3 * s->mesh.nodes; ++i) x[i] *= scale;
    for (i = 0; i < 3 * s->mesh.nodes; ++i) centre[i % 3] += x[i] / s->mesh.nodes;
    across = (axis + 1) % 3;
    a = (across + 1) % 3;
    b = (across + 2) % 3;
    for (i = 0; i < s->mesh.nodes; ++i) {
        if (!d->free && x[3 * i + axis] < limit) s->pins[s->pin_count++] = i;
        if (!d->free) continue;
        s->velocity[3 * i + a] = -6 * (x[3 * i + b] - centre[b]);
        s->velocity[3 * i + b] = 6 * (x[3 * i + a] - centre[a]);
    }
    if (!d->free) s->gravity[across] = -9.81;
    real_tips(s, axis);
}

REAL_STATIC void real_close(real_scene *s)
{
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
    free(s->pins);
    free(s->velocity);
    memset(s, 0, sizeof *s);
}

REAL_STATIC sfem_status real_open(const real_def *d, sfem_law law, double poisson, real_scene *s,
                                  sfem_error *err)
{
    sfem_model_def def = linear_model_def();
    sfem_status status;
    memset(s, 0, sizeof *s);
    s->def = d;
    status = real_mesh(d, &s->mesh, err);
    if (status != SFEM_OK) return status;
    s->pins = (sfem_int *)body_new((size_t)s->mesh.nodes, sizeof *s->pins);
    s->velocity = (sfem_real *)body_new(3 * (size_t)s->mesh.nodes, sizeof *s->velocity);
    real_place(s);
    def.mesh = &s->mesh;
    def.material.young = d->young;
    def.material.poisson = poisson;
    def.material.law = law;
    def.material.tet = real_tet;
    status = sfem_model_create(&def, &s->model, err);
    if (status != SFEM_OK) real_close(s);
    return status;
}

/* The default with the scene's pins and gravity. */
REAL_STATIC sfem_body_def real_body_def(const real_scene *s)
{
    sfem_body_def def = sfem_default_body_def();
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    memcpy(def.gravity, s->gravity, sizeof def.gravity);
    return def;
}

/* A body with the scene's velocities. */
REAL_STATIC sfem_status real_body(const real_scene *s, const sfem_body_def *def, sfem_body **out,
                                  sfem_error *err)
{
    sfem_status status = sfem_body_create(s->model, def, out, err);
    if (status == SFEM_OK) status = sfem_body_set_state(*out, NULL, s->velocity, err);
    return status;
}

#endif
