/* warp - what modal bodies cost and how far they are from the body that they stand for.
 *
 * A bar of 10 x 1 x 1 m, 24 x 3 x 3 cells of six tets, clamped at one end, E = 1e6 Pa, nu = 0.3, St.
 * Venant-Kirchhoff, which is the reference: at rest under its weight as a dead load, spread as the mass is, and
 * swinging after it is let go. Errors are RMS distances over all nodes, m. Then the time of a step, and of the
 * reconstruction of the surface, of a bar of 20 000 tets. One thread; medians of one run.
 *
 *     warp [--quick]        writes build/bench/warp.csv
 */
#include "../examples/support.h"
#include "bench.h"
#include "../tests/linear.h"

enum { REPEATS = 2001, MODES = 60, CLAMPED = 16 };

static const char *const warp_name[3] = {"linear", "R", "Rt"};

typedef struct bar {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_int pins[CLAMPED];
    double *force, *exact, *u; /* [nodes][3] */
} bar;

static bar make_bar(void)
{
    const sfem_int cells[3] = {24, 3, 3};
    const sfem_real size[3] = {10, 1, 1};
    sfem_model_def def = linear_model_def();
    sfem_error err;
    bar b;
    int i;
    bench_must(sfem_mesh_block(cells, size, SFEM_CELL_6_TETS, NULL, &b.mesh, &err), &err);
    def.mesh = &b.mesh;
    def.material.law = SFEM_STVK;
    def.material.stiffness_damping = 0.002;
    bench_must(sfem_model_create(&def, &b.model, &err), &err);
    for (i = 0; i < CLAMPED; ++i) b.pins[i] = i;
    b.force = (double *)ex_new(9 * (size_t)b.mesh.nodes, sizeof(double));
    b.exact = b.force + 3 * (size_t)b.mesh.nodes;
    b.u = b.exact + 3 * (size_t)b.mesh.nodes;
    return b;
}

static sfem_reduced *reduce(const bar *b, sfem_int count, sfem_reduced_view **view)
{
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def def = sfem_default_reduced_def();
    sfem_reduced *reduced;
    sfem_modes modes;
    sfem_error err;
    modes_def.modes = count;
    modes_def.tolerance = 1e-11; /* the highest of 60 take many restarts to 1e-13 */
    modes_def.pins = b->pins;
    modes_def.pin_count = CLAMPED;
    def.stiffness_damping = 0.002;
    bench_must(sfem_modes_create(b->model, &modes_def, &modes, &err), &err);
    bench_must(sfem_reduced_create(b->model, &modes, &def, &reduced, &err), &err);
    bench_must(sfem_reduced_view_create(reduced, 0, NULL, SFEM_DOUBLE, view, &err), &err);
    sfem_modes_free(&modes);
    return reduced;
}

static sfem_body *make_body(const bar *b)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body;
    sfem_error err;
    def.integrator = SFEM_NEWMARK;
    def.pins = b->pins;
    def.pin_count = CLAMPED;
    bench_must(sfem_body_create(b->model, &def, &body, &err), &err);
    return body;
}

static sfem_modal *make_modal(sfem_reduced *reduced, int warp, sfem_modal_integrator integrator)
{
    sfem_modal_def def = sfem_default_modal_def();
    sfem_modal *modal;
    sfem_error err;
    def.warp = (sfem_warp)warp;
    def.integrator = integrator;
    bench_must(sfem_modal_create(reduced, &def, &modal, &err), &err);
    return modal;
}

static void set_weight(bar *b, double newtons)
{
    const double *mass = sfem_model_node_mass(b->model);
    sfem_int i;
    for (i = 0; i < b->mesh.nodes; ++i)
        b->force[3 * i + 2] = -newtons * mass[i] / sfem_model_total_mass(b->model);
}

static double rms(const double *a, const double *b, sfem_int nodes)
{
    double sum = 0;
    sfem_int i;
    for (i = 0; i < 3 * nodes; ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
    return sqrt(sum / nodes);
}

/* Rest: error by way of warping, load and number of modes. */
static void statics(bar *b, FILE *csv)
{
    static const double weight[3] = {2000, 5000, 10000};
    static const sfem_int counts[4] = {5, 10, 30, MODES};
    double exact[3][3 * 400], drop[3], t[2];
    sfem_error err;
    int l, w, k, i;
    printf("\nat rest: RMS error, m, by tip drop, m (StVK)\n%-8s %5s", "warp", "modes");
    for (l = 0; l < 3; ++l) {
        sfem_body *body = make_body(b);
        set_weight(b, weight[l]);
        bench_must(sfem_body_set_lasting_force(body, b->force, &err), &err);
        t[0] = ex_seconds();
        bench_must(sfem_body_solve_static(body, &err), &err);
        t[0] = ex_seconds() - t[0];
        memcpy(exact[l], sfem_body_displacement(body), 3 * (size_t)b->mesh.nodes * sizeof(double));
        for (drop[l] = 0, i = 0; i < CLAMPED; ++i)
            drop[l] -= exact[l][3 * (b->mesh.nodes - 1 - i) + 2] / CLAMPED;
        printf(" %8.2f", drop[l]);
        sfem_body_free(body);
    }
    printf("   us (StVK %.0f)\n", 1e6 * t[0]);
    for (k = 0; k < 4; ++k) {
        sfem_reduced_view *view;
        sfem_reduced *reduced = reduce(b, counts[k], &view);
        for (w = 0; w < 3; ++w) {
            printf("%-8s %5d", warp_name[w], (int)counts[k]);
            for (l = 0; l < 3; ++l) {
                sfem_modal *modal = make_modal(reduced, w, SFEM_MODAL_NEWMARK);
                set_weight(b, weight[l]);
                bench_must(sfem_modal_set_lasting_force(modal, b->force, &err), &err);
                t[1] = ex_seconds();
                if (sfem_modal_solve_static(modal, NULL, &err) == SFEM_OK) {
                    t[1] = ex_seconds() - t[1];
                    sfem_modal_displacements(modal, view, b->u);
                    printf(" %8.3f", rms(b->u, exact[l], b->mesh.nodes));
                    fprintf(csv, "static,%s,%d,%g,%g,%g\n", warp_name[w], (int)counts[k], drop[l],
                            rms(b->u, exact[l], b->mesh.nodes), t[1]);
                } else {
                    printf(" %8s", "none");
                }
                sfem_modal_free(modal);
            }
            printf("   %.0f\n", 1e6 * t[1]);
        }
        sfem_reduced_view_free(view);
        sfem_reduced_free(reduced);
    }
}

/* A swing: let go under its weight, the lightest of the weights above. */
static void swing(bar *b, FILE *csv, int quick)
{
    static const sfem_int counts[3] = {5, 30, MODES};
    const double h = 1 / 60.0, seconds = quick ? 2 : 10;
    const int steps = (int)(seconds / h + 0.5), fine = 4;
    const size_t size = 3 * (size_t)b->mesh.nodes;
    double *exact = (double *)ex_new((size_t)steps * size, sizeof *exact), amplitude = 0, start,
           full;
    sfem_body *body = make_body(b);
    sfem_error err;
    int i, k, w;
    set_weight(b, 2000);
    bench_must(sfem_body_set_lasting_force(body, b->force, &err), &err);
    start = ex_seconds();
    for (i = 0; i < steps * fine; ++i) {
        bench_must(sfem_body_step(body, h / fine, &err), &err);
        if (i % fine == fine - 1)
            memcpy(exact + (size_t)(i / fine) * size, sfem_body_displacement(body),
                   size * sizeof(double));
    }
    full = (ex_seconds() - start) / (steps * fine);
    sfem_body_free(body);
    memset(b->u, 0, size * sizeof(double));
    for (i = 0; i < steps; ++i)
        amplitude = fmax(amplitude, rms(exact + (size_t)i * size, b->u, b->mesh.nodes));
    printf("\nswinging %g s, h = 1/60 s: RMS error over the largest RMS displacement, %.2f m; us a "
           "step, all nodes\n"
           "reconstructed (StVK, Newton, h = 1/240 s: %.0f us)\n%-8s %5s %9s %8s %9s %8s\n",
           seconds, amplitude, 1e6 * full, "warp", "modes", "Newmark", "us", "exact", "us");
    for (k = 0; k < 3; ++k) {
        sfem_reduced_view *view;
        sfem_reduced *reduced = reduce(b, counts[k], &view);
        for (w = 0; w < 3; ++w) {
            int kind;
            printf("%-8s %5d", warp_name[w], (int)counts[k]);
            for (kind = 0; kind < 2; ++kind) {
                sfem_modal *modal = make_modal(reduced, w, (sfem_modal_integrator)kind);
                const sfem_real g[3] = {0, 0, -2000 / sfem_model_total_mass(b->model)};
                double sum = 0, spent[600], cost;
                bench_must(sfem_modal_set_gravity(modal, g, &err), &err);
                for (i = 0; i < steps; ++i) {
                    start = ex_seconds();
                    bench_must(sfem_modal_step(modal, h, &err), &err);
                    sfem_modal_displacements(modal, view, b->u);
                    spent[i] = ex_seconds() - start;
                    sum += pow(rms(b->u, exact + (size_t)i * size, b->mesh.nodes), 2);
                }
                cost = bench_median(spent, steps);
                printf(" %9.4f %8.2f", sqrt(sum / steps) / amplitude, 1e6 * cost);
                fprintf(csv, "swing %s,%s,%d,%g,%g,%g\n", kind ? "exact" : "newmark", warp_name[w],
                        (int)counts[k], amplitude, sqrt(sum / steps) / amplitude, cost);
                sfem_modal_free(modal);
            }
            printf("\n");
        }
        sfem_reduced_view_free(view);
        sfem_reduced_free(reduced);
    }
    free(exact);
}

static double ceiling(size_t bytes) /* reading as much again and again: bytes a second */
{
    const size_t n = bytes / sizeof(double);
    double *a = (double *)ex_new(n, sizeof *a), t[101], sink = 0;
    size_t i;
    int k;
    for (k = 0; k < 101; ++k) {
        double s[8] = {0};
        t[k] = ex_seconds();
        for (i = 0; i + 8 <= n; i += 8) {
            s[0] += a[i], s[1] += a[i + 1], s[2] += a[i + 2], s[3] += a[i + 3];
            s[4] += a[i + 4], s[5] += a[i + 5], s[6] += a[i + 6], s[7] += a[i + 7];
        }
        t[k] = ex_seconds() - t[k];
        sink += s[0] + s[1] + s[2] + s[3] + s[4] + s[5] + s[6] + s[7];
    }
    free(a);
    return sink == 0 ? (double)bytes / bench_median(t, 101) : 0;
}

/* A step of a larger body, its surface reconstructed as floats. */
static void speed(FILE *csv)
{
    const sfem_int cells[3] = {40, 10, 10};
    const sfem_real size[3] = {4, 1, 1}, g[3] = {0, 0, -9.81}, f[3] = {0, 0, -1000};
    static double t[3][REPEATS];
    sfem_model_def def = linear_model_def();
    sfem_modes_def modes_def = sfem_default_modes_def();
    sfem_reduced_def reduced_def = sfem_default_reduced_def();
    sfem_int pins[121], i;
    sfem_reduced *reduced;
    sfem_model *model;
    sfem_modes modes;
    sfem_mesh mesh;
    sfem_error err;
    float *x;
    int p, w, load;
    bench_must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
    def.mesh = &mesh;
    bench_must(sfem_model_create(&def, &model, &err), &err);
    for (i = 0; i < 121; ++i) pins[i] = i;
    modes_def.modes = 20;
    modes_def.pins = pins;
    modes_def.pin_count = 121;
    bench_must(sfem_modes_create(model, &modes_def, &modes, &err), &err);
    bench_must(sfem_reduced_create(model, &modes, &reduced_def, &reduced, &err), &err);
    x = (float *)ex_new(3 * (size_t)mesh.nodes, sizeof *x);
    printf("\n%d tets, 20 modes, %d of %d nodes on the surface: us. Reading %.0f kB takes this "
           "machine at %.0f GB/s\n"
           "%-8s %-7s %-22s %7s %9s %7s %8s %6s\n",
           (int)mesh.tets, (int)sfem_reduced_get_info(reduced).surface_nodes, (int)mesh.nodes,
           432.0, ceiling(432000) / 1e9, "warp", "rows", "load", "step", "surface", "both",
           "ns/node", "GB/s");
    for (w = 0; w < 3; ++w)
        for (p = 0; p < 2; ++p) {
            sfem_reduced_view *view;
            bench_must(
                sfem_reduced_view_surface(reduced, p ? SFEM_MIXED : SFEM_DOUBLE, &view, &err),
                &err);
            for (load = 0; load < 2; ++load) {
                sfem_modal *modal = make_modal(reduced, w, SFEM_MODAL_NEWMARK);
                const double nodes = sfem_reduced_view_count(view);
                double reads;
                if (load) bench_must(sfem_modal_set_gravity(modal, g, &err), &err);
                bench_must(sfem_modal_add_lasting_force(modal, mesh.nodes - 1, f, &err), &err);
                for (i = -50; i < REPEATS; ++i) {
                    double a = ex_seconds(), b, c;
                    bench_must(sfem_modal_step(modal, 1 / 60.0, &err), &err);
                    b = ex_seconds();
                    sfem_modal_to_floats(modal, view, x, 3 * sizeof *x);
                    c = ex_seconds();
                    if (i < 0) continue;
                    t[0][i] = b - a, t[1][i] = c - b, t[2][i] = c - a;
                }
                for (i = 0; i < 3; ++i) t[i][0] = bench_median(t[i], REPEATS);
                reads = nodes * 20 * (w ? 6 : 3) * (p ? 4 : 8);
                printf("%-8s %-7s %-22s %7.2f %9.2f %7.2f %8.2f %6.0f\n", warp_name[w],
                       p ? "float" : "double", load ? "a node and gravity" : "a node",
                       1e6 * t[0][0], 1e6 * t[1][0], 1e6 * t[2][0], 1e9 * t[1][0] / nodes,
                       reads / t[1][0] / 1e9);
                fprintf(csv, "step,%s %s,20,%d,%g,%g\n", warp_name[w], p ? "float" : "double", load,
                        t[0][0], t[1][0]);
                sfem_modal_free(modal);
            }
            sfem_reduced_view_free(view);
        }
    free(x);
    sfem_reduced_free(reduced);
    sfem_modes_free(&modes);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
}

int main(int argc, char **argv)
{
    const int quick = argc > 1 && !strcmp(argv[1], "--quick");
    bar b = make_bar();
    FILE *csv;
    ex_make_directory("build/bench");
    csv = ex_open("build/bench/warp.csv");
    fprintf(csv, "what,warp,modes,drop or amplitude,error,seconds\n");
    printf("%s\n", SFEM_BENCH_FLAGS);
    statics(&b, csv);
    swing(&b, csv, quick);
    speed(csv);
    ex_close(csv, "build/bench/warp.csv");
    free(b.force);
    sfem_model_free(b.model);
    sfem_mesh_free(&b.mesh);
    return 0;
}
