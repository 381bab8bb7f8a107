/* reference.h - what the scenes of real.h really do: made once, kept in files.
 *
 *     reference_def d = {directory, "corotational", 0.38, quick};
 *     reference r = reference_of(&scene, &d);            [REFERENCE_SAMPLES][nodes][3] displacements
 *     free(r.u);
 *
 * The trapezoidal rule by full Newton to 1e-6, real_def.reference steps in 1/30 s (8 of a quick run), over a second.
 * DIR/NAME.ref holds a hash of all that the motion depends on, and the displacements every 1/30 s; DIR/NAME.txt
 * the command that makes it. A file that does not fit the scene is made anew.
 */
#ifndef SFEM_BENCH_REFERENCE_H
#define SFEM_BENCH_REFERENCE_H

#include "../examples/support.h"
#include "bench.h"
#include "real.h"

enum { REFERENCE_SAMPLES = 30, BENCH_SCRATCH = 300 };

/* A new directory [BENCH_SCRATCH] in SFEM_SCRATCH, or /tmp, for what another program reads and writes. 0: none. */
BENCH_STATIC int bench_scratch(char *directory)
{
    const char *in = getenv("SFEM_SCRATCH");
    if (!in || !*in) in = "/tmp";
    ex_make_directory(in);
    snprintf(directory, BENCH_SCRATCH, "%s/softfem_XXXXXX", in);
    return mkdtemp(directory) != NULL;
}

/* Removes it with all that is in it. */
BENCH_STATIC void bench_scratch_remove(const char *directory)
{
    char command[BENCH_SCRATCH + 20];
    snprintf(command, sizeof command, "rm -rf '%s'", directory);
    if (system(command)) printf("    (%s is left)\n", directory);
}

typedef struct reference_def {
    const char *out;      /* the directory */
    const char *law_name; /* of the scene's model, as bench/real --law has it */
    double poisson;
    int quick;
} reference_def;

typedef struct reference {
    double *u; /* [REFERENCE_SAMPLES][nodes][3] every 1/30 s */
} reference;

BENCH_STATIC uint64_t reference_hash(uint64_t h, const void *data, size_t bytes) /* FNV-1a */
{
    const unsigned char *c = (const unsigned char *)data;
    size_t i;
    for (i = 0; i < bytes; ++i) h = (h ^ c[i]) * 0x100000001b3u;
    return h;
}

/* Of all that the motion depends on. */
BENCH_STATIC uint64_t reference_scene_hash(const real_scene *s, const reference_def *o,
                                           int substeps)
{
    const size_t nodes = (size_t)s->mesh.nodes, tets = (size_t)s->mesh.tets;
    uint64_t h = 0xcbf29ce484222325u;
    h = reference_hash(h, s->mesh.x, 3 * nodes * sizeof *s->mesh.x);
    h = reference_hash(h, s->mesh.tet, 4 * tets * sizeof *s->mesh.tet);
    h = reference_hash(h, s->pins, (size_t)s->pin_count * sizeof *s->pins);
    h = reference_hash(h, s->velocity, 3 * nodes * sizeof *s->velocity);
    h = reference_hash(h, s->gravity, sizeof s->gravity);
    h = reference_hash(h, &s->def->young, sizeof s->def->young);
    h = reference_hash(h, &o->poisson, sizeof o->poisson);
    h = reference_hash(h, o->law_name, strlen(o->law_name));
    return reference_hash(h, &substeps, sizeof substeps);
}

/* "octopus-2e5-200000-corotational-0.38-960.ref" */
BENCH_STATIC const char *reference_path(const real_scene *s, const reference_def *o, int substeps,
                                        const char *end)
{
    char name[160];
    int i;
    snprintf(name, sizeof name, "%s-%g-%s-%g-%d.%s", s->def->name, s->def->young, o->law_name,
             o->poisson, 30 * substeps, end);
    for (i = 0; name[i]; ++i)
        if (name[i] == ' ') name[i] = '-';
    return ex_path(o->out, name);
}

BENCH_STATIC int reference_read(reference *r, size_t count, uint64_t hash, const char *path)
{
    FILE *f = fopen(path, "rb");
    uint64_t there = 0;
    int ok;
    if (!f) return 0;
    ok = fread(&there, sizeof there, 1, f) == 1 && there == hash &&
         fread(r->u, sizeof *r->u, count, f) == count;
    fclose(f);
    return ok;
}

BENCH_STATIC void reference_write(const reference *r, const real_scene *s, const reference_def *o,
                                  int substeps, const char *how)
{
    const size_t count = REFERENCE_SAMPLES * 3 * (size_t)s->mesh.nodes;
    const uint64_t hash = reference_scene_hash(s, o, substeps);
    FILE *f = ex_open(reference_path(s, o, substeps, "ref"));
    fwrite(&hash, sizeof hash, 1, f);
    fwrite(r->u, sizeof *r->u, count, f);
    ex_close(f, reference_path(s, o, substeps, "ref"));
    f = ex_open(reference_path(s, o, substeps, "txt"));
    fprintf(f, "bench/real --reference --scene '%s' --young %g --law %s --poisson %g%s --out %s\n",
            s->def->name, s->def->young, o->law_name, o->poisson, o->quick ? " --quick" : "",
            o->out);
    fprintf(f,
            "trapezoidal rule, Newton to 1e-6, h = 1/%d s, %s\n"
            "then the hash of the scene and [%d][%d][3] displacements every 1/30 s, in the "
            "machine's doubles\n",
            30 * substeps, how, REFERENCE_SAMPLES, (int)s->mesh.nodes);
    ex_close(f, reference_path(s, o, substeps, "txt"));
}

BENCH_STATIC void reference_make(reference *r, const real_scene *s, const reference_def *o,
                                 int substeps)
{
    const size_t n = 3 * (size_t)s->mesh.nodes;
    const double begin = bench_seconds();
    sfem_body_def def = real_body_def(s);
    double iterations = 0, first;
    char how[160];
    sfem_body *body;
    sfem_error err;
    int i, k;
    def.integrator = SFEM_NEWMARK;
    def.newton.accept_best = 1;
    def.newton.tolerance = 1e-6;
    bench_must(real_body(s, &def, &body, &err), &err);
    first = sfem_body_energy(body).total;
    for (i = 0; i < REFERENCE_SAMPLES; ++i) {
        for (k = 0; k < substeps; ++k) {
            bench_must(sfem_body_step(body, 1.0 / (30 * substeps), &err), &err);
            iterations += sfem_body_newton(body).iterations;
        }
        memcpy(r->u + (size_t)i * n, sfem_body_displacement(body), n * sizeof *r->u);
        ex_progress(s->def->name, i, REFERENCE_SAMPLES);
    }
    ex_progress(s->def->name, 1, 1);
    snprintf(how, sizeof how, "%.2f iterations a step, %.0f s; energy changed by %.3g J",
             iterations / (REFERENCE_SAMPLES * substeps), bench_seconds() - begin,
             sfem_body_energy(body).total - first);
    reference_write(r, s, o, substeps, how);
    sfem_body_free(body);
}

BENCH_STATIC reference reference_of(const real_scene *s, const reference_def *o)
{
    const int substeps = o->quick ? 8 : s->def->reference;
    const size_t count = REFERENCE_SAMPLES * 3 * (size_t)s->mesh.nodes;
    reference r;
    r.u = (double *)ex_new(count, sizeof *r.u);
    if (!reference_read(&r, count, reference_scene_hash(s, o, substeps),
                        reference_path(s, o, substeps, "ref")))
        reference_make(&r, s, o, substeps);
    return r;
}

#endif
