/* needs - what a scene pays for what it asks for: pairs of the same body without and with one thing.
 *
 * Full bodies: a bar of 2 x 0.5 x 0.5 m, 2500 tets, corotational, E = 1e6 Pa, nu = 0.45, held at one end, that falls;
 * h = 1/60 s; it starts again every 50 steps, since without the energy safeguard it explodes later. Modal bodies: the
 * same bar in 20 modes. The two of a pair step in turns in one process, so that both see the same machine; medians of
 * the processor's time of a step, one thread. Bytes: what the two hold when they step, factors included, the model and
 * what is drawn not.
 * Prints a table, writes needs.csv.
 *
 *     needs [--quick] [--out build/bench]
 */
#include "../examples/support.h"
#include "bench.h"

enum { SWING = 50, STEPS_MOST = 401, PAIRS = 11, MODAL_PAIRS = 6, HOLDS = 4 };

static const double h = 1 / 60.0;

/* --------------------------------------------------------------------------------------------
 * bytes that an allocator has given and not got back
 * -------------------------------------------------------------------------------------------- */

enum { HEAD = 64 }; /* before each block: its size */

static void *counted(size_t bytes, void *user)
{
    unsigned char *block = (unsigned char *)malloc(bytes + HEAD);
    if (!block) return NULL;
    memcpy(block, &bytes, sizeof bytes);
    *(size_t *)user += bytes;
    return block + HEAD;
}

static void uncounted(void *memory, void *user)
{
    size_t bytes;
    if (!memory) return;
    memcpy(&bytes, (unsigned char *)memory - HEAD, sizeof bytes);
    *(size_t *)user -= bytes;
    free((unsigned char *)memory - HEAD);
}

typedef struct cost {
    double seconds[STEPS_MOST], median;
    size_t bytes;
} cost;

static void print_pair(FILE *csv, const char *kind, const char *const text[3], const cost c[2])
{
    printf("%-32s %-24s %-26s %9.4g %9.4g %7.3g %9.1f %9.1f\n", text[0], text[1], text[2], 1e6 * c[0].median,
           1e6 * c[1].median, c[1].median / c[0].median, 1e-3 * (double)c[0].bytes, 1e-3 * (double)c[1].bytes);
    fflush(stdout);
    fprintf(csv, "%s,\"%s\",\"%s\",\"%s\",%.5g,%.5g,%.6g,%.6g\n", kind, text[0], text[1], text[2], 1e6 * c[0].median,
            1e6 * c[1].median, 1e-3 * (double)c[0].bytes, 1e-3 * (double)c[1].bytes);
}

/* --------------------------------------------------------------------------------------------
 * full bodies
 * -------------------------------------------------------------------------------------------- */

enum { CORRECTED, ROTATES, SAFE, BREAKS, HELD, REFACTORED, DOUBLE, SHARES, WATCHED, ASLEEP, ADAPTS };

static const char *const pair_text[PAIRS][3] = {
    {"corrections", "accuracy 1: one solve", "accuracy 1e-6, the default"},
    {"large rotations", "linear", "corotational, one solve"},
    {"energy safeguard, one solve", "off", "on"},
    {"breaking, before it breaks", "damage = NULL", "damage, no edge breaks"},
    {"handles, accuracy 1", "none", "4 nodes held"},
    {"refactorisation", "refactorise = 0", "refactorise = 4"},
    {"precision of the factor, linear", "mixed", "double"},
    {"workspace, two bodies", "shared", "one each"},
    {"watching for sleep", "sleep_tolerance = 0", "watched, moving"},
    {"sleep", "asleep", "awake and still"},
    {"step length, linear", "constant", "changes at each step"},
};

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model[2]; /* linear, corotational */
    sfem_int *pins, pin_count;
    int steps;
} scene;

static scene make_scene(int quick)
{
    const sfem_int cells[3] = {20, 5, 5};
    const sfem_real size[3] = {2, 0.5, 0.5};
    sfem_model_def def = sfem_default_model_def();
    sfem_error err;
    scene s;
    sfem_int i;
    int k;
    memset(&s, 0, sizeof s);
    bench_must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &s.mesh, &err), &err);
    def.mesh = &s.mesh;
    def.material.poisson = 0.45;
    for (k = 0; k < 2; ++k) {
        def.material.law = k ? SFEM_COROTATIONAL : SFEM_LINEAR;
        bench_must(sfem_model_create(&def, &s.model[k], &err), &err);
    }
    s.pins = (sfem_int *)ex_new((size_t)s.mesh.nodes, sizeof *s.pins);
    for (i = 0; i < s.mesh.nodes; ++i)
        if (s.mesh.x[3 * i] < 1e-9) s.pins[s.pin_count++] = i;
    s.steps = quick ? 61 : STEPS_MOST;
    return s;
}

/* One of the two of a pair; the damage outlives the call. */
static sfem_body *make_body(const scene *s, int pair, int with, sfem_workspace *workspace, size_t *bytes)
{
    static sfem_damage_def damage;
    const int linear = pair == DOUBLE || pair == ADAPTS || (pair == ROTATES && !with);
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body;
    sfem_error err;
    sfem_int i, handle;
    def.allocator.allocate = counted;
    def.allocator.release = uncounted;
    def.allocator.user = bytes;
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    def.gravity[2] = pair == ASLEEP ? 0 : -9.81;
    def.max_handles = HOLDS;
    if (pair == ROTATES || pair == SAFE || pair == HELD || (pair == CORRECTED && !with)) def.accuracy = 1;
    if (pair == SAFE) def.safeguard = with;
    if (pair == BREAKS && with) {
        damage = sfem_default_damage_def();
        damage.toughness = 1e12;
        def.damage = &damage;
    }
    if (pair == REFACTORED && with) def.refactorise = 4;
    if (pair == DOUBLE && !with) def.precision = SFEM_MIXED;
    if (pair == SHARES && !with) def.workspace = workspace;
    if (pair == WATCHED && with) def.sleep_tolerance = 1e-3;
    if (pair == ASLEEP && !with) def.sleep_tolerance = 1e9, def.sleep_time = 0; /* any speed is calm, at once */
    bench_must(sfem_body_create(s->model[!linear], &def, &body, &err), &err);
    for (i = 0; pair == HELD && with && i < HOLDS; ++i)
        bench_must(sfem_body_grab_node(body, s->mesh.nodes - 1 - 7 * i, &handle, &err), &err);
    bench_must(sfem_body_prepare(body, h, &err), &err);
    return body;
}

static double step_body(sfem_body *body, double length)
{
    sfem_error err;
    const double start = bench_seconds();
    bench_must(sfem_body_step(body, length, &err), &err);
    return bench_seconds() - start;
}

static void measure_pair(const scene *s, int pair, FILE *csv)
{
    static cost c[2];
    const int bodies = pair == SHARES ? 2 : 1, steps = pair == ADAPTS ? s->steps / 6 : s->steps;
    sfem_body *body[2][2];
    sfem_workspace *workspace = NULL;
    sfem_error err;
    int with, i, k;
    memset(c, 0, sizeof c);
    if (pair == SHARES) {
        sfem_allocator all;
        all.allocate = counted;
        all.release = uncounted;
        all.user = &c[0].bytes;
        bench_must(sfem_workspace_create(&all, &workspace, &err), &err);
    }
    for (with = 0; with < 2; ++with)
        for (k = 0; k < bodies; ++k) body[with][k] = make_body(s, pair, with, workspace, &c[with].bytes);
    for (with = 0; with < 2 && pair == ASLEEP; ++with)
        for (i = 0; i < 3; ++i) (void)step_body(body[with][0], h);
    for (i = -2; i < steps; ++i) {
        for (with = 0; with < 2 && pair != ASLEEP && i > 0 && i % SWING == 0; ++with)
            for (k = 0; k < bodies; ++k) bench_must(sfem_body_set_state(body[with][k], NULL, NULL, &err), &err);
        for (with = 0; with < 2; ++with) {
            const double length = pair == ADAPTS && with && i & 1 ? 0.9 * h : h;
            double t = 0;
            for (k = 0; k < bodies; ++k) t += step_body(body[with][k], length);
            if (i >= 0) c[with].seconds[i] = t;
        }
    }
    for (with = 0; with < 2; ++with) {
        c[with].median = bench_median(c[with].seconds, steps);
        c[with].bytes += sfem_body_get_info(body[with][0]).factor_bytes; /* the model's allocator gave these */
    }
    if (pair == ASLEEP) { /* too short for the clock */
        const double start = bench_seconds();
        for (i = 0; i < 100000; ++i) bench_must(sfem_body_step(body[0][0], h, &err), &err);
        c[0].median = (bench_seconds() - start) / 100000;
    }
    print_pair(csv, "full", pair_text[pair], c);
    for (with = 0; with < 2; ++with)
        for (k = 0; k < bodies; ++k) sfem_body_free(body[with][k]);
    sfem_workspace_free(workspace);
}

/* --------------------------------------------------------------------------------------------
 * modal bodies: a step and what is reconstructed after it
 * -------------------------------------------------------------------------------------------- */

enum { WARPED, SURFACE, ALL_NODES, ROWS, HAND, STEP_ALONE };

static const char *const modal_text[MODAL_PAIRS][3] = {
    {"modal: far bends", "warp none", "warp path, the default"},
    {"modal: what is drawn", "nothing: the step alone", "surface, float rows"},
    {"modal: which nodes", "surface", "all nodes"},
    {"modal: precision of the rows", "float", "double"},
    {"modal: a hand", "none", "a node held"},
    {"modal instead of full, surface", "20 modes", "corotational, accuracy 1"},
};

static sfem_reduced *reduce(const scene *s)
{
    sfem_modes_def def = sfem_default_modes_def();
    sfem_reduced_def reduced_def = sfem_default_reduced_def();
    sfem_reduced *reduced;
    sfem_modes modes;
    sfem_error err;
    def.modes = 20;
    def.pins = s->pins;
    def.pin_count = s->pin_count;
    bench_must(sfem_modes_create(s->model[0], &def, &modes, &err), &err);
    bench_must(sfem_reduced_create(s->model[0], &modes, &reduced_def, &reduced, &err), &err);
    sfem_modes_free(&modes);
    return reduced;
}

static sfem_modal *make_modal(const scene *s, sfem_reduced *reduced, int pair, int with, size_t *bytes)
{
    sfem_modal_def def = sfem_default_modal_def();
    sfem_modal *modal;
    sfem_error err;
    sfem_int handle;
    def.allocator.allocate = counted;
    def.allocator.release = uncounted;
    def.allocator.user = bytes;
    def.gravity[2] = -9.81;
    if (pair == WARPED && !with) def.warp = SFEM_WARP_NONE;
    bench_must(sfem_modal_create(reduced, &def, &modal, &err), &err);
    if (pair == HAND && with) bench_must(sfem_modal_grab_node(modal, s->mesh.nodes - 1, &handle, &err), &err);
    return modal;
}

static sfem_reduced_view *make_view(sfem_reduced *reduced, int pair, int with)
{
    const sfem_precision precision = pair == ROWS && with ? SFEM_DOUBLE : SFEM_MIXED;
    sfem_reduced_view *view = NULL;
    sfem_error err;
    if (pair == SURFACE && !with) return NULL;
    if (pair == ALL_NODES && with)
        bench_must(sfem_reduced_view_create(reduced, 0, NULL, precision, &view, &err), &err);
    else
        bench_must(sfem_reduced_view_surface(reduced, precision, &view, &err), &err);
    return view;
}

static double step_modal(sfem_modal *modal, const sfem_reduced_view *view, float *x)
{
    sfem_error err;
    const double start = bench_seconds();
    bench_must(sfem_modal_step(modal, h, &err), &err);
    if (view) sfem_modal_to_floats(modal, view, x, 3 * sizeof *x);
    return bench_seconds() - start;
}

static void measure_modal_pair(const scene *s, sfem_reduced *reduced, int pair, FILE *csv)
{
    static cost c[2];
    sfem_modal *modal[2] = {NULL, NULL};
    sfem_reduced_view *view[2] = {NULL, NULL};
    sfem_body *body = NULL;
    float *x = (float *)ex_new(3 * (size_t)s->mesh.nodes, sizeof *x);
    int with, i;
    memset(c, 0, sizeof c);
    for (with = 0; with < 2; ++with) {
        if (pair == STEP_ALONE && with) {
            body = make_body(s, ROTATES, 1, NULL, &c[1].bytes);
            break;
        }
        modal[with] = make_modal(s, reduced, pair, with, &c[with].bytes);
        view[with] = make_view(reduced, pair, with);
    }
    for (i = -5; i < s->steps; ++i)
        for (with = 0; with < 2; ++with) {
            const double t = modal[with] ? step_modal(modal[with], view[with], x) : step_body(body, h);
            if (i >= 0) c[with].seconds[i] = t;
        }
    for (with = 0; with < 2; ++with) {
        c[with].median = bench_median(c[with].seconds, s->steps);
        if (with && body) c[with].bytes += sfem_body_get_info(body).factor_bytes;
    }
    print_pair(csv, "modal", modal_text[pair], c);
    for (with = 0; with < 2; ++with) {
        sfem_modal_free(modal[with]);
        sfem_reduced_view_free(view[with]);
    }
    sfem_body_free(body);
    free(x);
}

int main(int argc, char **argv)
{
    static const ex_option table[] = {{"--quick", NULL, NULL, "fewer steps"},
                                      {"--out", "DIR", "build/bench", "where needs.csv goes"},
                                      {NULL, NULL, NULL, NULL}};
    const ex_options o = ex_parse(argc, argv, "What a scene pays for what it asks for.", table);
    const char *out = ex_text(&o, "--out");
    scene s = make_scene(ex_given(&o, "--quick"));
    sfem_reduced *reduced = reduce(&s);
    FILE *csv;
    int pair;
    ex_make_directory(out);
    csv = ex_open(ex_path(out, "needs.csv"));
    fprintf(csv, "kind,what,without,with,us_without,us_with,kb_without,kb_with\n");
    printf("a bar of %d tets, %d nodes; us a step, medians of %d; kB\n%s\n\n%-32s %-24s %-26s %9s %9s %7s %9s %9s\n",
           (int)s.mesh.tets, (int)s.mesh.nodes, s.steps, SFEM_BENCH_FLAGS, "", "without", "with", "us", "us", "with /",
           "kB", "kB");
    for (pair = CORRECTED; pair < PAIRS; ++pair) measure_pair(&s, pair, csv);
    for (pair = 0; pair < MODAL_PAIRS; ++pair) measure_modal_pair(&s, reduced, pair, csv);
    ex_close(csv, ex_path(out, "needs.csv"));
    printf("\nwrote %s\n", ex_path(out, "needs.csv"));
    sfem_reduced_free(reduced);
    sfem_model_free(s.model[0]);
    sfem_model_free(s.model[1]);
    sfem_mesh_free(&s.mesh);
    free(s.pins);
    return 0;
}
