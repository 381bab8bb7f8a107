/* mesher - tets from surfaces: time, number, angles, volume, distance, memory.
 *
 * Surfaces of its own, and those of a directory: that of --surfaces or of the environment variable SFEM_SURFACES. Each
 * is meshed fitted and as a cage, on one thread, into as many tets as asked for. What is printed is measured here by other
 * routes than the mesher's: a tree of boxes gives distances and, by dipoles, winding numbers.
 *
 *   wanted, tets  asked for, got           ms    median of three, time of the processor; where it is over 1 s of one
 *   least, most   dihedral angles, degrees        inverted    tets
 *   volume        % off the surface's; of one that is open or hides triangles, by the winding number at 200 000 points
 *   far, thick    Hausdorff distance in cells, "size" of the definition, from points of the surface (corners, middles,
 *                 20 000 at random) and of the mesh's surface (nodes, middles): at most; and where the body and what is
 *                 round it are over two cells thick: where a ball of two cells across, on either side of the surface,
 *                 comes within 3/4 cell of the point, as in the corner of a cube. A cage has none:
 *                 it lies around the surface
 *   hidden        % of the surface's points that lie inside of other parts; no distance is measured from them
 *   MB            most memory at a time
 *
 *     mesher [--surfaces DIR] [--tets N] [--quick] [--where]
 */
#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200809L
#endif
#include <dirent.h>
#include "../examples/support.h"
#include "../tests/bodies.h"
#include "bench.h"

#define TAU 6.283185307179586

/* ---- vectors ---- */

static void minus(const double *a, const double *b, double *c)
{
    int k;
    for (k = 0; k < 3; ++k) c[k] = a[k] - b[k];
}

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double *a, const double *b, double *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1], c[1] = a[2] * b[0] - a[0] * b[2], c[2] = a[0] * b[1] - a[1] * b[0];
}

/* Twice the area vector. */
static void normal(const double *a, const double *b, const double *c, double *n)
{
    double u[3], v[3];
    minus(b, a, u), minus(c, a, v), cross(u, v, n);
}

/* ---- a tree over triangles ---- */

typedef struct node {
    double low[3], high[3], centre[3], dipole[3], reach2;
    int first, count, skip;
} node;

typedef struct tree {
    double (*x)[3][3]; /* [count] corners */
    node *node;
    int count, nodes;
} tree;

static int axis_of_sort;

static int compare(const void *a, const void *b)
{
    const double(*p)[3] = (const double(*)[3])a, (*q)[3] = (const double(*)[3])b;
    const int c = axis_of_sort;
    const double u = p[0][c] + p[1][c] + p[2][c], v = q[0][c] + q[1][c] + q[2][c];
    return (u > v) - (u < v);
}

static void grow(tree *t, int first, int count)
{
    node *v = t->node + t->nodes++;
    double weight = 0;
    int i, k, c;
    memset(v, 0, sizeof *v);
    for (c = 0; c < 3; ++c) v->low[c] = HUGE_VAL, v->high[c] = -HUGE_VAL;
    for (i = first; i < first + count; ++i) {
        double n[3], area;
        normal(t->x[i][0], t->x[i][1], t->x[i][2], n);
        area = sqrt(dot(n, n));
        weight += area;
        for (c = 0; c < 3; ++c) {
            v->dipole[c] += 0.5 * n[c];
            for (k = 0; k < 3; ++k) {
                v->low[c] = fmin(v->low[c], t->x[i][k][c]), v->high[c] = fmax(v->high[c], t->x[i][k][c]);
                v->centre[c] += area / 3 * t->x[i][k][c];
            }
        }
    }
    for (c = 0; c < 3; ++c) v->centre[c] = weight > 0 ? v->centre[c] / weight : v->low[c];
    for (i = first; i < first + count; ++i)
        for (k = 0; k < 3; ++k) {
            double d[3];
            minus(t->x[i][k], v->centre, d);
            v->reach2 = fmax(v->reach2, 16 * dot(d, d)); /* a dipole serves from four radii on */
        }
    v->first = first;
    v->count = count > 4 ? 0 : count;
    if (count > 4) {
        axis_of_sort = 0;
        for (c = 1; c < 3; ++c)
            if (v->high[c] - v->low[c] > v->high[axis_of_sort] - v->low[axis_of_sort]) axis_of_sort = c;
        qsort(t->x + first, (size_t)count, sizeof *t->x, compare);
        grow(t, first, count / 2);
        grow(t, first + count / 2, count - count / 2);
    }
    v->skip = t->nodes;
}

static tree tree_of(const sfem_surface *s, const double *x)
{
    tree t;
    int i;
    t.count = s->triangles;
    t.nodes = 0;
    t.x = (double(*)[3][3])ex_new((size_t)t.count, sizeof *t.x);
    t.node = (node *)ex_new(2 * (size_t)t.count, sizeof *t.node);
    for (i = 0; i < 3 * t.count; ++i) memcpy(t.x[i / 3][i % 3], x + 3 * s->tri[i], sizeof t.x[0][0]);
    if (t.count) grow(&t, 0, t.count);
    return t;
}

static void tree_free(tree *t) { free(t->x), free(t->node); }

/* Squared distance of p from a triangle: of its plane, where the foot is inside, else of its sides. */
static double apart2(const double p[3], double x[3][3])
{
    double n[3], e[3], d[3], w[3], t, best = HUGE_VAL, foot[3];
    int k, c, inside = 1;
    normal(x[0], x[1], x[2], n);
    for (k = 0; k < 3; ++k) {
        minus(x[(k + 1) % 3], x[k], e), minus(p, x[k], d), cross(e, d, w);
        if (dot(w, n) < 0) inside = 0;
        t = dot(e, e) > 0 ? dot(d, e) / dot(e, e) : 0;
        t = t < 0 ? 0 : t > 1 ? 1 : t;
        for (c = 0; c < 3; ++c) foot[c] = d[c] - t * e[c];
        best = fmin(best, dot(foot, foot));
    }
    if (inside && dot(n, n) > 0) t = dot(d, n), best = fmin(best, t * t / dot(n, n));
    return best;
}

/* Distance from the triangles; it is not looked farther than `most`. */
static double distance(const tree *t, const double p[3], double most)
{
    double best = most * most;
    int i = 0, k, c;
    while (i < t->nodes) {
        const node *v = t->node + i;
        double far2 = 0;
        for (c = 0; c < 3; ++c) {
            const double d = fmax(0, fmax(v->low[c] - p[c], p[c] - v->high[c]));
            far2 += d * d;
        }
        i = far2 < best ? i + 1 : v->skip;
        for (k = 0; far2 < best && k < v->count; ++k) best = fmin(best, apart2(p, t->x[v->first + k]));
    }
    return sqrt(best);
}

/* The distance, looked for in steps that grow from `guess`. */
static double distance_from(const tree *t, const double p[3], double guess)
{
    double d = guess;
    while ((d = distance(t, p, guess)) >= guess && guess < 1e30) guess *= 4;
    return d;
}

static double winding(const tree *t, const double p[3])
{
    double sum = 0;
    int i = 0, k, j;
    while (i < t->nodes) {
        const node *v = t->node + i;
        double d[3], r2;
        minus(v->centre, p, d);
        r2 = dot(d, d);
        i = r2 > v->reach2 ? v->skip : i + 1;
        if (r2 > v->reach2) sum += dot(v->dipole, d) / (r2 * sqrt(r2));
        for (k = 0; !(r2 > v->reach2) && k < v->count; ++k) {
            double u[3][3], l[3], n[3];
            for (j = 0; j < 3; ++j) minus(t->x[v->first + k][j], p, u[j]), l[j] = sqrt(dot(u[j], u[j]));
            cross(u[1], u[2], n);
            sum += 2 * atan2(dot(u[0], n), l[0] * l[1] * l[2] + dot(u[0], u[1]) * l[2] + dot(u[1], u[2]) * l[0] +
                                               dot(u[2], u[0]) * l[1]);
        }
    }
    return sum / (2 * TAU);
}

static int within(const tree *t, const double p[3]) { return fabs(winding(t, p)) > 0.5; }

/* ---- orientation ---- */

static const double *weld_x;

static int by_place(const void *a, const void *b)
{
    const double *p = weld_x + 3 * *(const int *)a, *q = weld_x + 3 * *(const int *)b;
    int c;
    for (c = 0; c < 3; ++c)
        if (p[c] != q[c]) return p[c] < q[c] ? -1 : 1;
    return 0;
}

static int by_edge(const void *a, const void *b) { return memcmp(a, b, 2 * sizeof(int)); }

static int root_of(const int *parent, const unsigned char *odd, int t, int *sum)
{
    for (*sum = 0; parent[t] != t; t = parent[t]) *sum ^= odd[t];
    return t;
}

/* The same triangles, oriented as their neighbours are: in each part those of the smaller area are reversed. */
static sfem_surface oriented(const sfem_surface *s)
{
    const int n = s->triangles;
    sfem_surface out = *s;
    int *order = (int *)ex_new((size_t)s->nodes, sizeof *order), *id = (int *)ex_new((size_t)s->nodes, sizeof *id);
    int *parent = (int *)ex_new((size_t)n, sizeof *parent), t, k, end, sum[2];
    int(*edge)[4] = (int(*)[4])ex_new(3 * (size_t)n, sizeof *edge); /* nodes, triangle, sense */
    unsigned char *odd = (unsigned char *)ex_new((size_t)n, 1);
    double(*area)[2] = (double(*)[2])ex_new((size_t)n, sizeof *area), m[3];
    out.tri = (sfem_int *)ex_new(3 * (size_t)n, sizeof *out.tri);
    memcpy(out.tri, s->tri, 3 * (size_t)n * sizeof *out.tri);
    for (k = 0; k < s->nodes; ++k) order[k] = k;
    weld_x = s->x;
    qsort(order, (size_t)s->nodes, sizeof *order, by_place);
    for (k = 0; k < s->nodes; ++k)
        id[order[k]] = k && !by_place(order + k, order + k - 1) ? id[order[k - 1]] : order[k];
    for (k = 0; k < 3 * n; ++k) {
        const int a = id[s->tri[k]], b = id[s->tri[k % 3 == 2 ? k - 2 : k + 1]];
        edge[k][0] = a < b ? a : b, edge[k][1] = a < b ? b : a, edge[k][2] = k / 3, edge[k][3] = a < b;
    }
    qsort(edge, 3 * (size_t)n, sizeof *edge, by_edge);
    for (t = 0; t < n; ++t) parent[t] = t, area[t][0] = area[t][1] = 0;
    for (k = 0; k < 3 * n; k = end) {
        int p, q;
        for (end = k + 1; end < 3 * n && !by_edge(edge[k], edge[end]);) ++end;
        if (end != k + 2) continue;
        p = root_of(parent, odd, edge[k][2], sum), q = root_of(parent, odd, edge[k + 1][2], sum + 1);
        if (p == q) continue;
        parent[p > q ? p : q] = p > q ? q : p;
        odd[p > q ? p : q] = (unsigned char)(sum[0] ^ sum[1] ^ (edge[k][3] == edge[k + 1][3]));
    }
    for (end = 0; end < 2; ++end) /* areas, then what they decide */
        for (t = 0; t < n; ++t) {
            sfem_int *v = out.tri + 3 * t;
            const int r = root_of(parent, odd, t, sum);
            normal(s->x + 3 * v[0], s->x + 3 * v[1], s->x + 3 * v[2], m);
            if (!end)
                area[r][sum[0]] += sqrt(dot(m, m));
            else if (sum[0] != (area[r][1] > area[r][0]))
                k = v[1], v[1] = v[2], v[2] = k;
        }
    free(order), free(id), free(parent), free(edge), free(odd), free(area);
    return out;
}

/* ---- distances ---- */

/* Point k of those of a surface's triangles: corners and middles, then random ones by area, whose running sum is sum. */
static int sample(const sfem_surface *s, const double *x, const double *sum, int k, uint64_t *random, double p[3])
{
    double u = 1.0 / 3, v = 1.0 / 3;
    int t = k / 4, c;
    if (k < 4 * s->triangles) {
        if (k % 4) u = k % 4 == 1, v = k % 4 == 2;
    } else {
        double r[3], area;
        int low = 0, high = s->triangles - 1;
        for (c = 0; c < 3; ++c) {
            *random = *random * 6364136223846793005u + 1442695040888963407u;
            r[c] = (double)(*random >> 11) / 9007199254740992.0;
        }
        for (area = r[0] * sum[s->triangles - 1]; low < high;) {
            const int half = (low + high) / 2;
            if (sum[half] < area) low = half + 1;
            else high = half;
        }
        t = low;
        u = 1 - sqrt(r[1]), v = r[2] * sqrt(r[1]);
    }
    for (c = 0; c < 3; ++c)
        p[c] = u * x[3 * s->tri[3 * t] + c] + v * x[3 * s->tri[3 * t + 1] + c] +
               (1 - u - v) * x[3 * s->tri[3 * t + 2] + c];
    return t;
}

/* Does a ball of radius h come within 3/4 h of p, as in the corner of a cube, inside of the body, and one outside?
 * Their centres are looked for at the points of a grid of h/4: balls of 0.95 h may stand for those between. */
static int is_thick(const tree *shown, const tree *all, const double p[3], double h)
{
    int found[2] = {0, 0}, i, j, k;
    for (i = -7; i <= 7; ++i)
        for (j = -7; j <= 7; ++j)
            for (k = -7; k <= 7; ++k) {
                const double c[3] = {p[0] + 0.25 * h * i, p[1] + 0.25 * h * j, p[2] + 0.25 * h * k};
                if (i * i + j * j + k * k > 49 || distance(shown, c, h) < 0.95 * h) continue;
                found[within(all, c)] = 1;
                if (found[0] && found[1]) return 1;
            }
    return 0;
}

typedef struct far_point {
    double d, p[3];
} far_point;

static int farther(const void *a, const void *b)
{
    const double x = ((const far_point *)a)->d, y = ((const far_point *)b)->d;
    return (x < y) - (x > y);
}

static int is_near(const double p[3], const double q[3], double d)
{
    double e[3];
    minus(p, q, e);
    return dot(e, e) < d * d;
}

/* The surface without the triangles that are hidden wholly; returns the share of points that are. */
static double visible(const sfem_surface *s, const tree *all, double h, sfem_surface *out)
{
    int t, k, c, hidden = 0;
    *out = *s;
    out->triangles = 0;
    out->tri = (sfem_int *)ex_new(3 * (size_t)s->triangles, sizeof *out->tri);
    for (t = 0; t < s->triangles; ++t) {
        const double *x[3];
        double n[3], length;
        int shown = 0;
        for (k = 0; k < 3; ++k) x[k] = s->x + 3 * s->tri[3 * t + k];
        normal(x[0], x[1], x[2], n);
        length = sqrt(dot(n, n));
        for (k = 0; k < 4 && length > 0; ++k) { /* the middle, and near the corners */
            double p[2][3];
            for (c = 0; c < 3; ++c) {
                const double middle = (x[0][c] + x[1][c] + x[2][c]) / 3, at = 0.9 * middle + 0.1 * (k < 3 ? x[k][c] : middle);
                p[0][c] = at + 1e-4 * h * n[c] / length;
                p[1][c] = at - 1e-4 * h * n[c] / length;
            }
            shown += within(all, p[0]) != within(all, p[1]);
        }
        hidden += 4 - shown;
        if (shown) memcpy(out->tri + 3 * out->triangles++, s->tri + 3 * t, 3 * sizeof *s->tri);
    }
    return hidden / (4.0 * s->triangles);
}

/* far[0] over all points, far[1] over those that are within one cell and those where all is thick. */
static void measure_far(const sfem_surface *s, const tree *all, const sfem_mesh *m, double h, int where, double far[2])
{
    const int random_points = 20000;
    sfem_surface own;
    sfem_error err;
    tree shown = tree_of(s, s->x), mesh;
    double *sum = (double *)ex_new((size_t)s->triangles, sizeof *sum), p[3], n[3];
    far_point *list = (far_point *)ex_new(4 * (size_t)s->triangles + (size_t)random_points, sizeof *list);
    uint64_t random = 1;
    int k, t, c, count = 0, told = 0;
    bench_must(sfem_mesh_surface(m, NULL, &own, &err), &err);
    mesh = tree_of(&own, m->x);
    for (t = 0; t < s->triangles; ++t) {
        normal(s->x + 3 * s->tri[3 * t], s->x + 3 * s->tri[3 * t + 1], s->x + 3 * s->tri[3 * t + 2], n);
        sum[t] = (t ? sum[t - 1] : 0) + sqrt(dot(n, n));
    }
    far[0] = far[1] = 0;
    for (k = 0; k < 4 * own.triangles; ++k) { /* from the mesh: what is far has a ball round it, so it is thick */
        (void)sample(&own, m->x, NULL, k, &random, p);
        far[0] = fmax(far[0], distance_from(&shown, p, h));
    }
    far[1] = far[0];
    for (k = 0; k < 4 * s->triangles + random_points; ++k) {
        double side[2][3], length;
        far_point *f = list + count;
        t = sample(s, s->x, sum, k, &random, f->p);
        f->d = distance_from(&mesh, f->p, h);
        if (f->d <= far[0] && f->d <= h) continue;
        normal(s->x + 3 * s->tri[3 * t], s->x + 3 * s->tri[3 * t + 1], s->x + 3 * s->tri[3 * t + 2], n);
        if (!((length = sqrt(dot(n, n))) > 0)) continue;
        for (c = 0; c < 3; ++c) { /* a little within the triangle */
            const sfem_int *v = s->tri + 3 * t;
            const double middle = (s->x[3 * v[0] + c] + s->x[3 * v[1] + c] + s->x[3 * v[2] + c]) / 3;
            const double at = 0.99 * f->p[c] + 0.01 * middle;
            side[0][c] = at + 1e-4 * h * n[c] / length, side[1][c] = at - 1e-4 * h * n[c] / length;
        }
        if (within(all, side[0]) == within(all, side[1])) continue; /* hidden */
        far[0] = fmax(far[0], f->d);
        if (f->d <= h) far[1] = fmax(far[1], f->d); /* thick or not */
        ++count;
    }
    qsort(list, (size_t)count, sizeof *list, farther);
    for (k = 0; k < count && list[k].d > h; ++k) {
        int thick;
        for (t = 0; t < told && !is_near(list[k].p, list[t].p, 0.2 * h); ++t) {}
        if (t < told) continue; /* beside a thin place: those stand at the front of the list */
        thick = is_thick(&shown, all, list[k].p, h);
        if (where && (thick || told < 5))
            printf("  %.3f cells of %g at %g %g %g, %s\n", list[k].d / h, h, list[k].p[0], list[k].p[1], list[k].p[2],
                   thick ? "thick" : "thin");
        if (thick) {
            far[1] = list[k].d;
            break;
        }
        list[told++] = list[k];
    }
    tree_free(&shown), tree_free(&mesh), free(sum), free(list);
    sfem_surface_free(&own);
}

/* The volume: by the divergence theorem, or of the winding number at points that fill the box evenly [Roberts 2018]. */
static double volume(const tree *all, int whole)
{
    const node *box = all->node;
    double sum = 0, n[3], p[3];
    int t, k, c, inside = 0, points = 200000;
    for (t = 0; t < all->count && whole; ++t) {
        cross(all->x[t][0], all->x[t][1], n);
        sum += dot(n, all->x[t][2]) / 6;
    }
    if (whole) return fabs(sum);
    for (k = 0; k < points; ++k) {
        static const double step[3] = {0.8191725133961645, 0.6710436067037893, 0.5497004779019703};
        for (c = 0; c < 3; ++c) p[c] = box->low[c] + (box->high[c] - box->low[c]) * fmod(0.5 + step[c] * k, 1);
        inside += within(all, p);
    }
    for (c = 0, sum = (double)inside / points; c < 3; ++c) sum *= box->high[c] - box->low[c];
    return sum;
}

/* ---- memory ---- */

typedef struct memory {
    size_t now, most;
} memory;

static void *take(size_t bytes, void *user)
{
    memory *m = (memory *)user;
    size_t *block = (size_t *)malloc(bytes + 16);
    if (!block) return NULL;
    *block = bytes;
    m->now += bytes;
    if (m->now > m->most) m->most = m->now;
    return block + 2;
}

static void give(void *block, void *user)
{
    if (!block) return;
    ((memory *)user)->now -= ((size_t *)block)[-2];
    free((size_t *)block - 2);
}

/* ---- rows ---- */

static void row(const char *name, const sfem_surface *s, int wanted, int where)
{
    int mode, k;
    for (mode = SFEM_FITTED; mode <= SFEM_CAGE; ++mode) {
        sfem_mesher_def def = sfem_default_mesher_def();
        memory used = {0, 0};
        sfem_mesher_info info;
        sfem_mesh_report report;
        sfem_error err;
        sfem_mesh m;
        sfem_surface shown, right = oriented(s);
        tree all;
        double time[3], far[2] = {0, 0}, hidden, inside;
        def.mode = (sfem_mesher_mode)mode;
        def.tets = wanted;
        def.exec.threads = 1;
        def.allocator.allocate = take, def.allocator.release = give, def.allocator.user = &used;
        for (k = 0; k < 3 && (k == 0 || time[0] < 1); ++k) {
            if (k) sfem_mesh_free(&m);
            time[k] = bench_seconds();
            if (sfem_mesh_from_surface(&def, s, &m, &info, &err) != SFEM_OK) {
                printf("%-22s %s\n", name, err.text);
                return;
            }
            time[k] = bench_seconds() - time[k];
        }
        bench_must(sfem_mesh_check(&m, &report, &err), &err);
        all = tree_of(&right, s->x);
        hidden = visible(&right, &all, info.size, &shown);
        inside = volume(&all, hidden <= 0 && !info.open_edges && !info.doubled);
        if (where)
            printf("  open edges %d, reversed %d, doubled %d, without area %d\n", (int)info.open_edges,
                   (int)info.flipped, (int)info.doubled, (int)info.degenerate);
        if (mode == SFEM_FITTED) measure_far(&shown, &all, &m, info.size, where, far);
        printf("%-22s %-6s %8d %6d %6d %5.0f %5.1f %5.1f %4d %7.2f ", name, mode ? "cage" : "fitted", (int)s->triangles,
               wanted, (int)m.tets, 1e3 * bench_median(time, k), info.min_dihedral, info.max_dihedral,
               (int)report.inverted, 100 * (info.volume / inside - 1));
        if (mode)
            printf("%5s %5s", "", "");
        else
            printf("%5.2f %5.2f", far[0] / info.size, far[1] / info.size);
        printf(" %6.1f %5.1f\n", 100 * hidden, 1e-6 * (double)used.most);
        fflush(stdout);
        sfem_mesh_free(&m);
        free(shown.tri);
        free(right.tri);
        tree_free(&all);
    }
}

/* ---- surfaces of its own ---- */

static sfem_surface new_surface(int nodes, int triangles)
{
    sfem_surface s;
    memset(&s, 0, sizeof s);
    s.nodes = nodes;
    s.triangles = triangles;
    s.x = (double *)ex_new(3 * (size_t)nodes, sizeof *s.x);
    s.tri = (sfem_int *)ex_new(3 * (size_t)triangles, sizeof *s.tri);
    return s;
}

/* A tube of radius r about a circle or a trefoil knot, in n x m quadrilaterals, outward. */
static sfem_surface tube(int knot, int n, int m, double r)
{
    sfem_surface s = new_surface(n * m, 2 * n * m);
    int i, j, c;
    for (i = 0; i < n; ++i) {
        const double up[3] = {0, 0, 1};
        double a[2][3], t[3], e[3], f[3], length;
        for (c = 0; c < 2; ++c) {
            const double u = TAU * (i + 1e-4 * c) / n;
            a[c][0] = knot ? 0.5 * (sin(u) + 2 * sin(2 * u)) : cos(u);
            a[c][1] = knot ? 0.5 * (cos(u) - 2 * cos(2 * u)) : sin(u);
            a[c][2] = knot ? -0.5 * sin(3 * u) : 0;
        }
        minus(a[1], a[0], t);
        for (length = sqrt(dot(t, t)), c = 0; c < 3; ++c) t[c] /= length;
        cross(t, up, e);
        for (length = sqrt(dot(e, e)), c = 0; c < 3; ++c) e[c] /= length;
        cross(t, e, f);
        for (j = 0; j < m; ++j) {
            const double v = TAU * j / m;
            const sfem_int next = (i + 1) % n * m, up1 = (j + 1) % m, q[6] = {i * m + j, next + up1, next + j,
                                                                              i * m + j, i * m + up1, next + up1};
            for (c = 0; c < 3; ++c) s.x[3 * (i * m + j) + c] = a[0][c] + r * (cos(v) * e[c] + sin(v) * f[c]);
            memcpy(s.tri + 6 * (i * m + j), q, sizeof q);
        }
    }
    return s;
}

static sfem_surface boxes(int count, const double (*corner)[2][3])
{
    static const sfem_int face[36] = {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
                                      2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5};
    sfem_surface s = new_surface(8 * count, 12 * count);
    int b, k, c;
    for (b = 0; b < count; ++b) {
        for (k = 0; k < 8; ++k)
            for (c = 0; c < 3; ++c) s.x[3 * (8 * b + k) + c] = corner[b][k >> c & 1][c];
        for (k = 0; k < 36; ++k) s.tri[36 * b + k] = 8 * b + face[k];
    }
    return s;
}

static double gyroid(const double x[3], void *user)
{
    (void)user;
    return sin(x[0]) * cos(x[1]) + sin(x[1]) * cos(x[2]) + sin(x[2]) * cos(x[0]);
}

/* The surface of a fine mesh of a function. */
static void function_row(const char *name, sfem_sdf f, double low, double high, int wanted, int where)
{
    const double box[2][3] = {{low, low, low}, {high, high, high}};
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_surface s;
    sfem_error err;
    sfem_mesh m;
    def.tets = 100000;
    bench_must(sfem_mesh_from_sdf(&def, f, NULL, box, &m, NULL, &err), &err);
    bench_must(sfem_mesh_surface(&m, NULL, &s, &err), &err);
    s.x = m.x;
    s.nodes = m.nodes;
    row(name, &s, wanted, where);
    s.x = NULL;
    sfem_surface_free(&s);
    sfem_mesh_free(&m);
}

static void own_rows(int wanted, int where)
{
    static const double plate[2][2][3] = {{{0, 0, 0}, {1, 1, 0.1}}, {{0.45, 0.45, 0.05}, {0.55, 0.55, 1}}};
    static const double letter[3][2][3] = {{{0, 0, 0}, {0.25, 1, 0.25}}, {{0.75, 0, 0}, {1, 1, 0.25}},
                                           {{0.1, 0.4, 0}, {0.9, 0.6, 0.25}}};
    sfem_surface s[4];
    static const char *const name[4] = {"torus", "knot", "plate with a rod", "letter H of boxes"};
    int k;
    s[0] = tube(0, 350, 100, 0.4), s[1] = tube(1, 350, 100, 0.25), s[2] = boxes(2, plate), s[3] = boxes(3, letter);
    for (k = 0; k < 4; ++k) {
        row(name[k], s + k, wanted, where);
        free(s[k].x), free(s[k].tri);
    }
    function_row("body with limbs", body_blended, -1.3, 1.3, wanted, where);
    function_row("gyroid", gyroid, 0, TAU, wanted, where);
}

static int by_name(const void *a, const void *b) { return strcmp(*(char *const *)a, *(char *const *)b); }

static void directory_rows(const char *folder, int wanted, int where)
{
    char *name[256];
    int count = 0, k;
    DIR *d = opendir(folder);
    struct dirent *e;
    if (!d) ex_fail("%s: no such directory", folder);
    while ((e = readdir(d)) != NULL && count < 256) {
        const char *dot_at = strrchr(e->d_name, '.');
        if (!dot_at || !dot_at[1] || !strstr(".obj.stl.ply.off", dot_at)) continue;
        name[count] = (char *)ex_new(strlen(e->d_name) + 1, 1);
        strcpy(name[count++], e->d_name);
    }
    closedir(d);
    qsort(name, (size_t)count, sizeof *name, by_name);
    for (k = 0; k < count; ++k) {
        sfem_surface s;
        sfem_error err;
        if (sfem_surface_read(ex_path(folder, name[k]), NULL, &s, &err) != SFEM_OK)
            printf("%-22s %s\n", name[k], err.text);
        else {
            row(name[k], &s, wanted, where);
            sfem_surface_free(&s);
        }
        free(name[k]);
    }
}

int main(int argc, char **argv)
{
    static const ex_option table[] = {
        {"--surfaces", "DIR", NULL, "a directory of .obj, .stl, .ply, .off; else that of SFEM_SURFACES"},
        {"--tets", "N", "20000", "how many are wanted"},
        {"--quick", NULL, NULL, "files only, or without such the surfaces of its own at 5000 tets"},
        {"--where", NULL, NULL, "the places that are farthest"},
        {NULL, NULL, NULL, NULL}};
    const ex_options o = ex_parse(argc, argv, "Tets from surfaces: time, angles, volume, distance, memory.", table);
    const char *folder = ex_given(&o, "--surfaces") ? ex_text(&o, "--surfaces") : getenv("SFEM_SURFACES");
    const int quick = ex_given(&o, "--quick"), where = ex_given(&o, "--where");
    const int wanted = quick && !ex_given(&o, "--tets") ? 5000 : (int)ex_count(&o, "--tets", 10);
    printf("%s\n%-22s %-6s %8s %6s %6s %5s %5s %5s %4s %7s %5s %5s %6s %5s\n", SFEM_BENCH_FLAGS, "surface", "mode",
           "tri", "wanted", "tets", "ms", "least", "most", "inv", "volume", "far", "thick", "hidden", "MB");
    if (!quick || !folder || !*folder) own_rows(wanted, where);
    if (folder && *folder) directory_rows(folder, wanted, where);
    return 0;
}
