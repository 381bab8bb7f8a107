/* race.h - error against run time of linear and smooth tets and CalculiX's C3D10. Part of bench/accuracy.c, after
 * tets.h; --race FILE.svg runs it.
 *
 * A cantilever of 4 x 1 x 1 m, nu = 0.45, under a shear traction at its end: the deflection of the middle of the end, of
 * meshes of n x n cells across and 4 n along, in linear statics. The reference is that of C3D10 with n = 8. Times are the
 * processor's: of making the model, the factor and the solution here; of the whole of ccx, with its files, there.
 */
#ifndef SFEM_BENCH_RACE_H
#define SFEM_BENCH_RACE_H

#include <sys/resource.h>

enum { RACE_CURVES = 5, RACE_POINTS = 6 };

typedef struct race_curve {
    const char *name, *color;
    int count, n[RACE_POINTS];
    double error[RACE_POINTS], seconds[RACE_POINTS];
} race_curve;

static void race_map(double x[3]) { x[0] *= 4; }
static int race_end(const double *x) { return x[0] > 4 - 1e-9; }

static tets_case race_bar(int n, sfem_block_cells cells)
{
    const double shear[3] = {0, 0, -50};
    tets_case c;
    sfem_int i;
    tets_cells = cells;
    c = tets_open(4 * n, n, n, race_map, 1e6, 0.45);
    tets_cells = SFEM_CELL_6_TETS;
    for (i = 0; i < c.mesh.nodes; ++i)
        if (c.mesh.x[3 * i] < 1e-9) c.held[i] = SFEM_AXIS_ALL;
    tets_load(&c, race_end, shear, 0);
    return c;
}

static double race_children(void)
{
    struct rusage r;
    getrusage(RUSAGE_CHILDREN, &r);
    return (double)(r.ru_utime.tv_sec + r.ru_stime.tv_sec) + 1e-6 * (double)(r.ru_utime.tv_usec + r.ru_stime.tv_usec);
}

/* The middle of the end by CalculiX; NAN without it. */
static double race_quadratic(int n, double *seconds)
{
    tets_case c = race_bar(n, SFEM_CELL_6_TETS);
    const sfem_int node = tets_at(&c, 4, 0.5, 0.5);
    double u[3], stress[6], start = race_children();
    const int found = tets_calculix(&c, 1, node, u, stress);
    *seconds = race_children() - start;
    tets_close(&c);
    return found ? u[2] : NAN;
}

static double race_own(int n, sfem_block_cells cells, sfem_tet tet, double *seconds)
{
    tets_case c = race_bar(n, cells);
    const sfem_int node = tets_at(&c, 4, 0.5, 0.5);
    double found = 0;
    int tries, k;
    *seconds = 1e300;
    for (tries = n < 5 ? 5 : 1; tries > 0; --tries) {
        double start = bench_seconds();
        for (k = 0; k < (n < 5 ? 3 : 1); ++k) tets_solve(&c, tet);
        *seconds = fmin(*seconds, (bench_seconds() - start) / k);
    }
    found = c.u[3 * node + 2];
    tets_close(&c);
    return found;
}

/* How long a curve takes to an error, by straight lines in logarithms; beyond its ends by the last two points. */
static double race_time_to(const race_curve *c, double error)
{
    int k = 0;
    double t;
    while (k + 2 < c->count && c->error[k + 1] > error) ++k;
    t = log(error / c->error[k]) / log(c->error[k + 1] / c->error[k]);
    return c->seconds[k] * pow(c->seconds[k + 1] / c->seconds[k], t);
}

static double race_x(double seconds) { return 60 + 90 * (log10(seconds) + 4); }
static double race_y(double error) { return 20 + 90 * -log10(error); }

static void race_draw(const char *path, const race_curve *curve)
{
    FILE *f = fopen(path, "w");
    int k, i;
    if (!f) ex_fail("cannot write %s", path);
    fprintf(f, "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 680 340\" font-family=\"sans-serif\" font-size=\"12\">\n"
               "<rect width=\"680\" height=\"340\" fill=\"white\"/>\n");
    for (k = -4; k <= 1; ++k)
        fprintf(f, "<path d=\"M%.0f 20V290\" stroke=\"#ddd\"/><text x=\"%.0f\" y=\"306\" text-anchor=\"middle\">%g s</text>\n",
                race_x(pow(10, k)), race_x(pow(10, k)), pow(10, k));
    for (k = -3; k <= 0; ++k)
        fprintf(f, "<path d=\"M60 %.0fH510\" stroke=\"#ddd\"/><text x=\"54\" y=\"%.0f\" text-anchor=\"end\">%g</text>\n",
                race_y(pow(10, k)), race_y(pow(10, k)) + 4, pow(10, k));
    fprintf(f, "<text x=\"285\" y=\"330\" text-anchor=\"middle\">processor time</text>\n"
               "<text x=\"14\" y=\"155\" text-anchor=\"middle\" transform=\"rotate(-90 14 155)\">error of the deflection</text>\n");
    for (k = 0; k < RACE_CURVES; ++k) {
        const race_curve *c = curve + k;
        if (c->count == 0) continue;
        fprintf(f, "<polyline fill=\"none\" stroke=\"%s\" stroke-width=\"2\" points=\"", c->color);
        for (i = 0; i < c->count; ++i) fprintf(f, "%.1f,%.1f ", race_x(c->seconds[i]), race_y(c->error[i]));
        fprintf(f, "\"/>\n");
        for (i = 0; i < c->count; ++i)
            fprintf(f, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3.5\" fill=\"%s\"/>\n", race_x(c->seconds[i]),
                    race_y(c->error[i]), c->color);
        fprintf(f, "<text x=\"520\" y=\"%d\" fill=\"%s\">%s</text>\n", 40 + 20 * k, c->color, c->name);
    }
    fprintf(f, "</svg>\n");
    fclose(f);
}

static void race(const char *path)
{
    race_curve curve[RACE_CURVES] = {{"linear, five-tet cells", "#e08080", 5, {2, 4, 6, 8, 10}, {0}, {0}},
                                     {"linear, six-tet cells", "#b02020", 5, {2, 4, 6, 8, 10}, {0}, {0}},
                                     {"smooth, five-tet cells", "#70a0e0", 4, {2, 4, 6, 8}, {0}, {0}},
                                     {"smooth, six-tet cells", "#2050b0", 4, {2, 4, 6, 8}, {0}, {0}},
                                     {"C3D10 (ccx), six-tet cells", "#308030", 3, {2, 4, 6}, {0}, {0}}};
    double seconds, exact = race_quadratic(8, &seconds);
    int k, i;
    if (!(exact < 0)) ex_fail("the reference needs CalculiX: apt-get install calculix-ccx");
    printf("C3D10, n = 8: %.8g m\n\n%-28s %4s %10s %12s\n", exact, "cantilever, nu 0.45", "n", "error", "seconds");
    for (k = 0; k < RACE_CURVES; ++k)
        for (i = 0; i < curve[k].count; ++i) {
            race_curve *c = curve + k;
            const double found = k == 4 ? race_quadratic(c->n[i], c->seconds + i)
                                        : race_own(c->n[i], k % 2 ? SFEM_CELL_6_TETS : SFEM_CELL_5_TETS,
                                                   k / 2 ? SFEM_TET_SMOOTH : SFEM_TET_LINEAR, c->seconds + i);
            c->error[i] = fabs(found / exact - 1);
            printf("%-28s %4d %10.5f %12.6f\n", c->name, c->n[i], c->error[i], c->seconds[i]);
            fflush(stdout);
        }
    for (k = 0; k < 2; ++k) /* the errors that smooth tets have at n = 2 and 4 */
        for (i = 0; i < 2; ++i)
            printf("%s: to an error of %.4f linear tets take %.1f times as long as smooth ones\n", k ? "six-tet cells" : "five-tet cells",
                   curve[2 + k].error[i], race_time_to(curve + k, curve[2 + k].error[i]) / curve[2 + k].seconds[i]);
    race_draw(path, curve);
}

#endif
