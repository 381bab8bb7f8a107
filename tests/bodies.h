/* bodies.h - unstructured meshes for tests and benches: a body with limbs, filled with scattered points.
 *
 *     body_scattered(tets, q_min, seed, &mesh, &err)   about so many tets; the same bits each time
 *     body_distance(x), body_volume()                  of the shape that it fills
 *     body_blended(x, user)                            another shape, smooth: a trunk, a head, four limbs
 *     body_quality(x, tet)                             of a tet, as in sfem_mesh_report
 *     body_below(mesh, q)                              the share of the tets of a lower quality
 *
 * The shape is a union of capsules: a trunk of radius 0.25 m, a head, two arms, two legs and a tail of
 * radii 0.07 to 0.16 m, together 2 m long along x. Points are scattered on its surface and inside
 * (random sequential packing, distances in proportion to the root of the local radius) and connected
 * by the Delaunay tetrahedralisation; tets outside of the shape are removed. That leaves slivers, as
 * in most meshes made in this way. Those below q_min are improved by moving their nodes, or removed
 * at the surface.
 *   tets    wanted: 500 to 20 000. Mostly within a tenth; at 500 a limb may be missing
 *   q_min   0 to 0.1, reached by every tet of the 120 meshes tried. More than half of the tets are
 *           above 0.7; with q_min = 0.01 3 to 5 % are below 0.1
 *   errors  those of sfem_mesh_copy; where memory runs out in between, the program ends
 *   cost    0.05 ms a tet (measured)
 */
#ifndef SFEM_TESTS_BODIES_H
#define SFEM_TESTS_BODIES_H

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "softfem.h"
#include "blocks.h"

#define BODY_STATIC static __attribute__((unused))

BODY_STATIC void *body_new(size_t count, size_t size)
{
    void *p = calloc(count ? count : 1, size);
    if (p) return p;
    fprintf(stderr, "bodies.h: out of memory\n");
    exit(2);
}

/* ---- the shape ---- */

typedef struct body_capsule {
    double a[3], b[3], radius; /* the points within radius of the segment from a to b */
} body_capsule;

static const body_capsule body_part[] = {
    {{-0.30, 0, 0}, {0.25, 0, 0}, 0.25},         /* trunk */
    {{0.52, 0, 0.06}, {0.60, 0, 0.10}, 0.16},    /* head */
    {{0.22, 0.15, 0}, {0.45, 0.75, -0.1}, 0.09}, /* arms */
    {{0.22, -0.15, 0}, {0.30, -0.70, 0.25}, 0.07},
    {{-0.35, 0.10, -0.05}, {-1.05, 0.30, -0.1}, 0.12}, /* legs */
    {{-0.35, -0.10, -0.05}, {-1.15, -0.25, 0.05}, 0.11},
    {{-0.30, 0, 0.15}, {-0.75, 0.02, 0.5}, 0.08}, /* tail */
};
#define BODY_PARTS (int)(sizeof body_part / sizeof *body_part)
#define BODY_REACH 1.3 /* all of it lies in the cube of half this side about the origin */

/* Distance from the surface, negative inside: exact outside, and inside at most its depth. `part` is the capsule
 * whose surface is the nearest, gradient [3] points away from it; both may be NULL. */
BODY_STATIC double body_distance_of(const double x[3], int *part, double gradient[3])
{
    double best = 1e300;
    int i, k;
    for (i = 0; i < BODY_PARTS; ++i) {
        const body_capsule *c = body_part + i;
        double ab[3], ax[3], dot = 0, length2 = 0, t, d[3], distance = 0;
        for (k = 0; k < 3; ++k) {
            ab[k] = c->b[k] - c->a[k];
            ax[k] = x[k] - c->a[k];
            dot += ab[k] * ax[k];
            length2 += ab[k] * ab[k];
        }
        t = dot / length2;
        t = t < 0 ? 0 : t > 1 ? 1 : t;
        for (k = 0; k < 3; ++k) {
            d[k] = ax[k] - t * ab[k];
            distance += d[k] * d[k];
        }
        distance = sqrt(distance);
        if (distance - c->radius >= best) continue;
        best = distance - c->radius;
        if (part) *part = i;
        for (k = 0; gradient && k < 3; ++k) gradient[k] = distance > 0 ? d[k] / distance : k == 2;
    }
    return best;
}

BODY_STATIC double body_distance(const double x[3]) { return body_distance_of(x, NULL, NULL); }

/* m^3, by counting midpoints of cells of 1 cm: to some 0.1 % */
BODY_STATIC double body_volume(void)
{
    const double cell = 0.01;
    const int n = (int)(2 * BODY_REACH / cell);
    double x[3];
    long inside = 0;
    int i, j, k;
    for (i = 0; i < n; ++i)
        for (j = 0; j < n; ++j)
            for (k = 0; k < n; ++k) {
                x[0] = -BODY_REACH + (i + 0.5) * cell;
                x[1] = -BODY_REACH + (j + 0.5) * cell;
                x[2] = -BODY_REACH + (k + 0.5) * cell;
                if (fabs(x[1]) < 0.9 && fabs(x[2]) < 0.7) inside += body_distance(x) < 0;
            }
    return (double)inside * cell * cell * cell;
}

/* ---- scattered points ---- */

typedef struct body_random {
    uint64_t state;
} body_random;

BODY_STATIC double body_uniform(body_random *r, double low, double high)
{
    return block_uniform(&r->state, low, high);
}

/* Points are stored as whole numbers of steps of BODY_STEP, so that the Delaunay tests below are exact. */
#define BODY_STEP (BODY_REACH / 8192)

typedef struct body_points {
    int n, room, surface; /* the first `surface` of them lie on the surface */
    int64_t (*grid)[3];   /* [n] */
    double spacing;       /* m, in the trunk */
    int cells;            /* of the cube, a side */
    int *head, *next;     /* [cells^3] and [n]: the points of each cell, as lists; -1 ends one */
} body_points;

/* The distance wanted between points round x. */
BODY_STATIC double body_spacing(const body_points *p, const double x[3])
{
    int part = 0;
    body_distance_of(x, &part, NULL);
    return p->spacing * sqrt(body_part[part].radius / body_part[0].radius);
}

BODY_STATIC int body_cell(const body_points *p, double x)
{
    const int i = (int)((x + BODY_REACH) / (2 * BODY_REACH) * p->cells);
    return i < 0 ? 0 : i >= p->cells ? p->cells - 1 : i;
}

/* Adds x, unless a point is nearer than `distance`, which is no more than a cell. */
BODY_STATIC void body_add(body_points *p, const double x[3], double distance)
{
    int cell[3], low[3], high[3], i, j, k, c;
    for (k = 0; k < 3; ++k) {
        cell[k] = body_cell(p, x[k]);
        low[k] = cell[k] > 0 ? cell[k] - 1 : 0;
        high[k] = cell[k] + 1 < p->cells ? cell[k] + 1 : cell[k];
    }
    for (i = low[0]; i <= high[0]; ++i)
        for (j = low[1]; j <= high[1]; ++j)
            for (k = low[2]; k <= high[2]; ++k)
                for (c = p->head[(i * p->cells + j) * p->cells + k]; c >= 0; c = p->next[c]) {
                    const double a = (double)p->grid[c][0] * BODY_STEP - x[0];
                    const double b = (double)p->grid[c][1] * BODY_STEP - x[1];
                    const double d = (double)p->grid[c][2] * BODY_STEP - x[2];
                    if (a * a + b * b + d * d < distance * distance) return;
                }
    if (p->n == p->room) return;
    for (k = 0; k < 3; ++k) p->grid[p->n][k] = (int64_t)floor(x[k] / BODY_STEP + 0.5);
    c = (cell[0] * p->cells + cell[1]) * p->cells + cell[2];
    p->next[p->n] = p->head[c];
    p->head[c] = p->n++;
}

/* Points at random, each no nearer to the others than the spacing there, until so many tries have
 * failed that hardly any fits in: first on the surface, then inside. */
BODY_STATIC body_points body_scatter(double spacing, int room, uint64_t seed)
{
    body_points p;
    body_random r;
    long tries;
    int i, k;
    memset(&p, 0, sizeof p);
    r.state = seed;
    p.spacing = spacing;
    p.room = room;
    p.cells = (int)(2 * BODY_REACH / spacing);
    p.grid = (int64_t(*)[3])body_new((size_t)room, sizeof *p.grid);
    p.next = (int *)body_new((size_t)room, sizeof *p.next);
    p.head = (int *)body_new((size_t)(p.cells * p.cells * p.cells), sizeof *p.head);
    for (i = 0; i < p.cells * p.cells * p.cells; ++i) p.head[i] = -1;
    for (tries = 0; tries < 200L * room; ++tries) {
        const int inside = tries >= 60L * room;
        double x[3], gradient[3], d, s;
        if (tries == 60L * room) p.surface = p.n;
        x[0] = body_uniform(&r, -BODY_REACH, BODY_REACH);
        x[1] = body_uniform(&r, -0.9, 0.9);
        x[2] = body_uniform(&r, -0.5, 0.7);
        d = body_distance_of(x, NULL, gradient);
        s = body_spacing(&p, x);
        if (inside) {
            if (d < -0.5 * s) body_add(&p, x, s);
        } else if (fabs(d) < s) {
            for (k = 0; k < 3; ++k) x[k] -= d * gradient[k];
            if (fabs(body_distance(x)) < 1e-9) body_add(&p, x, s);
        }
    }
    return p;
}

BODY_STATIC void body_points_free(body_points *p)
{
    free(p->grid);
    free(p->next);
    free(p->head);
}

/* ---- Delaunay tetrahedralisation [Bowyer 1981, Watson 1981], in exact whole numbers ---- */

/* Right-handed tets; next[i] is the tet behind the face opposite to v[i], -1 outside. */
typedef struct body_tet {
    int v[4], next[4];
    int mark; /* the last point whose insertion has seen it; -1: free */
} body_tet;

typedef struct body_delaunay {
    int64_t (*x)[3];      /* [points+4], |x| <= 2^15: the last four make a tet round all others */
    body_tet *tet;        /* [room] */
    int tets, room, last; /* the last one made */
    int *cavity,
        *hole; /* [room] tets whose spheres hold the new point; the new ones in their place */
    int *empty, empties; /* [room] numbers of tets to be used again */
} body_delaunay;

/* six times the signed volume; below 2^52 */
BODY_STATIC int64_t body_orientation(const int64_t *a, const int64_t *b, const int64_t *c,
                                     const int64_t *d)
{
    const int64_t u[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
    const int64_t v[3] = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
    const int64_t w[3] = {d[0] - a[0], d[1] - a[1], d[2] - a[2]};
    return u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) +
           u[2] * (v[0] * w[1] - v[1] * w[0]);
}

/* Is p inside of the sphere through the four nodes of t? With b_i the barycentric coordinates of p in t,
 * sum b_i |v_i - p|^2 = R^2 - |p - centre|^2; here times the volume. Terms of up to 2^86 are added in two
 * halves. */
BODY_STATIC int body_in_sphere(const body_delaunay *g, const body_tet *t, const int64_t *p)
{
    const int64_t half = (int64_t)1 << 26;
    int64_t high = 0, low = 0;
    int i;
    for (i = 0; i < 4; ++i) {
        const int64_t *v[4], *x = g->x[t->v[i]];
        const int64_t d[3] = {x[0] - p[0], x[1] - p[1], x[2] - p[2]};
        const int64_t lift = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]; /* <= 3 2^32 */
        int64_t volume, top;
        int k;
        for (k = 0; k < 4; ++k) v[k] = k == i ? p : g->x[t->v[k]];
        volume = body_orientation(v[0], v[1], v[2], v[3]);
        top = volume >= 0 ? volume / half : -((half - 1 - volume) / half); /* rounded down */
        high += lift * top;
        low += lift * (volume - top * half);
    }
    high += low / half; /* low >= 0 */
    low %= half;
    return high > 0 || (high == 0 && low > 0);
}

BODY_STATIC int body_take(body_delaunay *g)
{
    if (g->empties) return g->empty[--g->empties];
    if (g->tets < g->room) return g->tets++;
    fprintf(stderr, "bodies.h: more than 20 tets a point\n");
    exit(2);
}

/* The tet that holds point p, by a walk from the last one. */
BODY_STATIC int body_walk(const body_delaunay *g, int p)
{
    int at = g->last, i, k;
    for (;;) {
        const body_tet *t = g->tet + at;
        for (i = 0; i < 4; ++i) { /* of a Delaunay mesh such a walk never goes in circles */
            const int64_t *v[4];
            for (k = 0; k < 4; ++k) v[k] = g->x[k == i ? p : t->v[k]];
            if (body_orientation(v[0], v[1], v[2], v[3]) < 0) break;
        }
        if (i == 4) return at;
        at = t->next[i];
    }
}

/* Joins tets a and b if they share a face. */
BODY_STATIC void body_join(body_delaunay *g, int a, int b)
{
    body_tet *s = g->tet + a, *t = g->tet + b;
    int i, k, off_s = 6, off_t = 6, same = 0; /* 0+1+2+3 less the three shared is the one left */
    for (i = 0; i < 4; ++i)
        for (k = 0; k < 4; ++k)
            if (s->v[i] == t->v[k]) {
                ++same;
                off_s -= i;
                off_t -= k;
            }
    if (same < 3) return;
    s->next[off_s] = b;
    t->next[off_t] = a;
}

/* The tets whose spheres hold point p are taken out, and p is joined to the faces of the hole. With exact tests
 * and "hold" strict, the hole is star-shaped seen from p, and no new tet is flat. */
BODY_STATIC void body_insert(body_delaunay *g, int p)
{
    int cavity = 1, faces = 0, i, j, k;
    g->cavity[0] = body_walk(g, p);
    g->tet[g->cavity[0]].mark = p;
    for (i = 0; i < cavity; ++i)
        for (k = 0; k < 4; ++k) {
            const int other = g->tet[g->cavity[i]].next[k];
            if (other >= 0 && g->tet[other].mark == p) continue;
            if (other >= 0 && body_in_sphere(g, g->tet + other, g->x[p])) {
                g->tet[other].mark = p;
                g->cavity[cavity++] = other;
            }
        }
    for (i = 0; i < cavity; ++i)
        for (k = 0; k < 4; ++k) {
            const int other = g->tet[g->cavity[i]].next[k];
            int at;
            body_tet *t;
            if (other >= 0 && g->tet[other].mark == p) continue;
            at = body_take(g);
            t = g->tet + at;
            *t = g->tet[g->cavity[i]];
            t->v[k] = p;
            t->mark = -1;
            for (j = 0; j < 4; ++j) {
                if (other >= 0 && g->tet[other].next[j] == g->cavity[i]) g->tet[other].next[j] = at;
                t->next[j] = j == k ? other : -1;
            }
            for (j = 0; j < faces; ++j) body_join(g, at, g->hole[j]);
            g->hole[faces++] = at;
        }
    for (i = 0; i < cavity; ++i) {
        g->tet[g->cavity[i]].v[0] = -1;
        g->empty[g->empties++] = g->cavity[i];
    }
    g->last = g->hole[0];
}

/* The Delaunay tets of the points, [4] nodes each; their number is returned. Free it. */
BODY_STATIC int body_connect(const body_points *p, int **out)
{
    static const int64_t around[4][3] = {{1, 1, 1}, {1, -1, -1}, {-1, 1, -1}, {-1, -1, 1}};
    body_delaunay g;
    int i, k, n = 0;
    memset(&g, 0, sizeof g);
    g.room = 20 * p->n + 100;
    g.x = (int64_t(*)[3])body_new((size_t)p->n + 4, sizeof *g.x);
    g.tet = (body_tet *)body_new((size_t)g.room, sizeof *g.tet);
    g.cavity = (int *)body_new((size_t)g.room, sizeof *g.cavity);
    g.hole = (int *)body_new((size_t)g.room, sizeof *g.hole);
    g.empty = (int *)body_new((size_t)g.room, sizeof *g.empty);
    memcpy(g.x, p->grid, (size_t)p->n * sizeof *g.x);
    for (i = 0; i < 4; ++i)
        for (k = 0; k < 3; ++k) g.x[p->n + i][k] = around[i][k] * 32768;
    for (k = 0; k < 4; ++k) {
        g.tet[0].v[k] = p->n + k;
        g.tet[0].next[k] = -1;
    }
    g.tet[0].mark = -1;
    g.tets = 1;
    if (body_orientation(g.x[p->n], g.x[p->n + 1], g.x[p->n + 2], g.x[p->n + 3]) < 0) {
        g.tet[0].v[0] = p->n + 1;
        g.tet[0].v[1] = p->n;
    }
    for (i = 0; i < p->n; ++i) body_insert(&g, i);
    *out = (int *)body_new(4 * (size_t)g.tets, sizeof **out);
    for (i = 0; i < g.tets; ++i) {
        const int *v = g.tet[i].v;
        if (v[0] < 0 || v[0] >= p->n || v[1] >= p->n || v[2] >= p->n || v[3] >= p->n) continue;
        memcpy(*out + 4 * n++, v, 4 * sizeof *v);
    }
    free(g.x);
    free(g.tet);
    free(g.cavity);
    free(g.hole);
    free(g.empty);
    return n;
}

/* ---- from the tetrahedralisation to a mesh ---- */

/* 6 sqrt(2) V / l^3, l the root mean square of the edges: 1 for the regular tet */
BODY_STATIC double body_quality(const sfem_real *x, const sfem_int *tet)
{
    double d[6][3], volume, l2 = 0;
    static const int from[6] = {0, 0, 0, 1, 1, 2}, to[6] = {1, 2, 3, 2, 3, 3};
    int e, k;
    for (e = 0; e < 6; ++e)
        for (k = 0; k < 3; ++k) {
            d[e][k] = x[3 * tet[to[e]] + k] - x[3 * tet[from[e]] + k];
            l2 += d[e][k] * d[e][k] / 6;
        }
    volume = (d[0][1] * d[1][2] - d[0][2] * d[1][1]) * d[2][0] +
             (d[0][2] * d[1][0] - d[0][0] * d[1][2]) * d[2][1] +
             (d[0][0] * d[1][1] - d[0][1] * d[1][0]) * d[2][2];
    return sqrt(2.0) * volume / (l2 * sqrt(l2));
}

BODY_STATIC double body_below(const sfem_mesh *m, double q)
{
    sfem_int t, n = 0;
    for (t = 0; t < m->tets; ++t) n += body_quality(m->x, m->tet + 4 * t) < q;
    return (double)n / m->tets;
}

/* A mesh in the making, and which of its tets are kept. */
typedef struct body_work {
    int nodes, tets, surface; /* the first `surface` nodes stay on the surface */
    double *x;                /* [nodes][3] */
    int *tet;                 /* [tets][4] */
    unsigned char *kept;      /* [tets] */
    int *start, *star;        /* [nodes+2], [4 tets]: the tets at node i are star[start[i]] .. */
    int *next;                /* [tets][4] the tet behind each face, or -1 */
    int *group, *queue;       /* [tets] for body_flood */
    int *seen; /* [nodes] for body_loops: the last node that has met this one, from 1 */
    int groups;
    body_random random;
} body_work;

BODY_STATIC int body_has(const int *tet, int node)
{
    return tet[0] == node || tet[1] == node || tet[2] == node || tet[3] == node;
}

/* Which tets stand at each node, and behind each face. */
BODY_STATIC void body_neighbours(body_work *w)
{
    int i, k, n;
    for (i = 0; i < 4 * w->tets; ++i) ++w->start[w->tet[i] + 2];
    for (i = 1; i <= w->nodes; ++i) w->start[i + 1] += w->start[i];
    for (i = 0; i < 4 * w->tets; ++i) w->star[w->start[w->tet[i] + 1]++] = i / 4;
    for (i = 0; i < 4 * w->tets; ++i) {
        const int *t = w->tet + 4 * (i / 4), at = t[(i + 1) % 4]; /* a node of the face */
        w->next[i] = -1;
        for (n = w->start[at]; n < w->start[at + 1]; ++n) {
            const int other = w->star[n];
            int same = 0;
            for (k = 0; k < 4; ++k) same += k != i % 4 && body_has(w->tet + 4 * other, t[k]);
            if (same == 3 && other != i / 4) w->next[i] = other;
        }
    }
}

/* Marks the kept tets that hang together with tet t by faces, all of them with nodes a and b where these are not
 * -1; returns how many. */
BODY_STATIC int body_flood(body_work *w, int t, int a, int b)
{
    int count = 1, i, k;
    w->queue[0] = t;
    w->group[t] = ++w->groups;
    for (i = 0; i < count; ++i)
        for (k = 0; k < 4; ++k) {
            const int at = w->queue[i], other = w->next[4 * at + k], off = w->tet[4 * at + k];
            if (other < 0 || !w->kept[other] || w->group[other] == w->groups) continue;
            if (off == a || off == b) continue;
            w->group[other] = w->groups;
            w->queue[count++] = other;
        }
    return count;
}

/* Of the listed tets with nodes a and b those are kept that belong to the largest such part; returns how many
 * others there were. */
BODY_STATIC int body_keep_largest(body_work *w, const int *list, int count, int a, int b)
{
    const int before = w->groups;
    int largest = 0, winner = 0, dropped = 0, i;
    for (i = 0; i < count; ++i) {
        const int t = list ? list[i] : i;
        int n;
        if (!w->kept[t] || w->group[t] > before || (b >= 0 && !body_has(w->tet + 4 * t, b)))
            continue;
        n = body_flood(w, t, a, b);
        if (n <= largest) continue;
        largest = n;
        winner = w->groups;
    }
    for (i = 0; i < count; ++i) {
        const int t = list ? list[i] : i;
        if (!w->kept[t] || w->group[t] <= before || w->group[t] == winner) continue;
        w->kept[t] = 0;
        ++dropped;
    }
    return dropped;
}

/* How many loops do the surface's faces round a node make? More than one where the surface touches itself. Where
 * the tets round the node hang together by faces, the sphere about it has Euler's number 2 less the loops. */
BODY_STATIC int body_loops(const body_work *w, int node)
{
    int n, k, tets = 0, faces = 0, edges = 0; /* at the node; faces counted twice */
    for (n = w->start[node]; n < w->start[node + 1]; ++n) {
        const int t = w->star[n];
        if (!w->kept[t]) continue;
        ++tets;
        for (k = 0; k < 4; ++k) {
            const int other = w->tet[4 * t + k], behind = w->next[4 * t + k];
            if (other == node) continue;
            faces += behind < 0 || !w->kept[behind] ? 2 : 1;
            edges += w->seen[other] != node + 1;
            w->seen[other] = node + 1;
        }
    }
    return tets ? 2 - (edges - faces / 2 + tets) : 0;
}

/* Takes tets out until what is left hangs together by faces, round each edge and node, too, and the surface touches
 * itself nowhere: it then is a manifold. */
BODY_STATIC void body_clean(body_work *w)
{
    int dropped, i, k, l, n;
    do {
        dropped = body_keep_largest(w, NULL, w->tets, -1, -1);
        for (i = 0; i < w->nodes; ++i)
            dropped +=
                body_keep_largest(w, w->star + w->start[i], w->start[i + 1] - w->start[i], i, -1);
        for (i = 0; i < w->tets; ++i)
            for (k = 1; k < 4; ++k)
                for (l = 0; l < k && w->kept[i]; ++l) {
                    const int a = w->tet[4 * i + k], b = w->tet[4 * i + l];
                    dropped += body_keep_largest(w, w->star + w->start[a],
                                                 w->start[a + 1] - w->start[a], a, b);
                }
        for (i = 0; i < w->nodes && !dropped; ++i)
            for (n = w->start[i]; n < w->start[i + 1] && body_loops(w, i) > 1; ++n) {
                dropped += w->kept[w->star[n]];
                w->kept[w->star[n]] = 0;
            }
    } while (dropped);
}

/* Is the tet inside of the shape, its middle and, but for a little, the middles of its edges? */
BODY_STATIC int body_inside(const body_work *w, const body_points *p, const int *tet)
{
    double middle[3] = {0, 0, 0};
    int i, k, c;
    for (i = 0; i < 4; ++i)
        for (c = 0; c < 3; ++c) middle[c] += w->x[3 * tet[i] + c] / 4;
    if (body_distance(middle) >= 0) return 0;
    for (i = 1; i < 4; ++i)
        for (k = 0; k < i; ++k) {
            double half[3];
            for (c = 0; c < 3; ++c) half[c] = (w->x[3 * tet[i] + c] + w->x[3 * tet[k] + c]) / 2;
            if (body_distance(half) > 0.2 * body_spacing(p, half)) return 0;
        }
    return 1;
}

/* The least quality of the kept tets at a node. */
BODY_STATIC double body_worst(const body_work *w, int node)
{
    double worst = 1;
    int n;
    for (n = w->start[node]; n < w->start[node + 1]; ++n)
        if (w->kept[w->star[n]]) {
            const double q = body_quality(w->x, w->tet + 4 * w->star[n]);
            if (q < worst) worst = q;
        }
    return worst;
}

/* Moves nodes of tets below q at random, wherever that makes the worst tet round the node better. */
BODY_STATIC void body_improve(body_work *w, double q, double spacing)
{
    int sweep, t, i, k, attempt, bad = 1;
    for (sweep = 0; sweep < 30 && bad; ++sweep)
        for (bad = t = 0; t < w->tets; ++t) {
            if (!w->kept[t] || body_quality(w->x, w->tet + 4 * t) >= q) continue;
            ++bad;
            for (attempt = 0; attempt < 40; ++attempt) {
                const int node = w->tet[4 * t + attempt % 4];
                const double before = body_worst(w, node),
                             reach = spacing * 0.4 / (1 + attempt / 8);
                double *x = w->x + 3 * node, old[3], gradient[3], d;
                for (k = 0; k < 3; ++k) {
                    old[k] = x[k];
                    x[k] += body_uniform(&w->random, -reach, reach);
                }
                for (i = 0; i < 3 && node < w->surface; ++i) {
                    d = body_distance_of(x, NULL, gradient);
                    for (k = 0; k < 3; ++k) x[k] -= d * gradient[k];
                }
                if (body_worst(w, node) > before) continue;
                for (k = 0; k < 3; ++k) x[k] = old[k];
            }
        }
}

/* May a tet be taken out that shows so many faces at the surface, those opposite to the nodes with open[k]? Yes, if
 * that makes no hole and no pinch: what is left of it touches the surface nowhere else. */
BODY_STATIC int body_loose(const body_work *w, int t, const int open[4], int count)
{
    const int *v = w->tet + 4 * t;
    int k, n, i, inner[4], nodes = 0;
    if (count < 1 || count > 3) return 0;
    for (k = 0; k < 4; ++k) /* 1 open face: its opposite node; 2: the edge that is in neither */
        if (open[k]) inner[nodes++] = v[k];
    if (count == 3) return 1;
    for (n = w->start[inner[0]]; n < w->start[inner[0] + 1]; ++n) {
        const int other = w->star[n];
        if (!w->kept[other] || (count == 2 && !body_has(w->tet + 4 * other, inner[1]))) continue;
        for (i = 0; i < 4; ++i) {
            const int at = w->tet[4 * other + i], behind = w->next[4 * other + i];
            if (at == inner[0] || (count == 2 && at == inner[1])) continue;
            if (behind < 0 || !w->kept[behind])
                return 0; /* an open face with the node, or the edge */
        }
    }
    return 1;
}

/* Takes out tets below q that show at the surface. */
BODY_STATIC void body_peel(body_work *w, double q)
{
    int t, k, dropped;
    do {
        for (dropped = t = 0; t < w->tets; ++t) {
            int open[4], count = 0;
            if (!w->kept[t] || body_quality(w->x, w->tet + 4 * t) >= q) continue;
            for (k = 0; k < 4; ++k) {
                open[k] = w->next[4 * t + k] < 0 || !w->kept[w->next[4 * t + k]];
                count += open[k];
            }
            if (!body_loose(w, t, open, count)) continue;
            w->kept[t] = 0;
            ++dropped;
        }
    } while (dropped);
}

BODY_STATIC sfem_status body_result(const body_work *w, sfem_mesh *out, sfem_error *err)
{
    sfem_int *tet = (sfem_int *)body_new(4 * (size_t)w->tets, sizeof *tet), n = 0;
    sfem_status status;
    int t, k;
    for (t = 0; t < w->tets; ++t)
        for (k = 0; k < 4 && w->kept[t]; ++k) tet[n++] = w->tet[4 * t + k];
    status = sfem_mesh_copy(w->nodes, w->x, n / 4, tet, NULL, out, err);
    free(tet);
    if (status == SFEM_OK) status = sfem_mesh_remove_unused(out, NULL, err);
    return status;
}

BODY_STATIC sfem_status body_mesh(const body_points *p, double q_min, uint64_t seed, sfem_mesh *out,
                                  sfem_error *err)
{
    body_work w;
    sfem_status status;
    int i, round;
    memset(&w, 0, sizeof w);
    w.nodes = p->n;
    w.surface = p->surface;
    w.random.state = seed ^ 0x5eed;
    w.tets = body_connect(p, &w.tet);
    w.x = (double *)body_new(3 * (size_t)w.nodes, sizeof *w.x);
    w.kept = (unsigned char *)body_new((size_t)w.tets, 1);
    w.start = (int *)body_new((size_t)w.nodes + 2, sizeof *w.start);
    w.star = (int *)body_new(4 * (size_t)w.tets, sizeof *w.star);
    w.next = (int *)body_new(4 * (size_t)w.tets, sizeof *w.next);
    w.group = (int *)body_new((size_t)w.tets, sizeof *w.group);
    w.queue = (int *)body_new((size_t)w.tets, sizeof *w.queue);
    w.seen = (int *)body_new((size_t)w.nodes, sizeof *w.seen);
    for (i = 0; i < 3 * w.nodes; ++i) w.x[i] = (double)p->grid[i / 3][i % 3] * BODY_STEP;
    for (i = 0; i < w.tets; ++i) w.kept[i] = (unsigned char)body_inside(&w, p, w.tet + 4 * i);
    body_neighbours(&w);
    body_clean(&w);
    body_peel(&w, q_min);
    for (round = 0; round < 3; ++round) {
        body_improve(&w, q_min, p->spacing);
        body_peel(&w, q_min);
    }
    status = body_result(&w, out, err);
    free(w.tet);
    free(w.x);
    free(w.kept);
    free(w.start);
    free(w.star);
    free(w.next);
    free(w.group);
    free(w.queue);
    free(w.seen);
    return status;
}

BODY_STATIC sfem_status body_scattered(sfem_int tets, double q_min, uint64_t seed, sfem_mesh *out,
                                       sfem_error *err)
{
    body_points p = body_scatter(1.29 * cbrt(1.0 / tets), tets, seed);
    const sfem_status status = body_mesh(&p, q_min, seed, out, err);
    body_points_free(&p);
    return status;
}

/* A trunk, a head, four limbs, blended: the smallest distance, m, rounded off [the exponential minimum]. A sfem_sdf. */
BODY_STATIC sfem_real body_blended(const sfem_real x[3], void *user)
{
    static const double limb[6][7] = {{-0.6, 0, 0, 0.6, 0, 0, 0.3},          {0.8, 0, 0.35, 0.9, 0, 0.4, 0.25},
                                      {0.5, 0.2, -0.2, 0.6, 0.3, -0.9, 0.1}, {0.5, -0.2, -0.2, 0.6, -0.3, -0.9, 0.1},
                                      {-0.5, 0.2, -0.2, -0.6, 0.3, -0.9, 0.1}, {-0.5, -0.2, -0.2, -0.6, -0.3, -0.9, 0.1}};
    double sum = 0;
    int k, c;
    (void)user;
    for (k = 0; k < 6; ++k) {
        double along = 0, length = 0, square = 0;
        for (c = 0; c < 3; ++c) {
            const double e = limb[k][3 + c] - limb[k][c];
            along += (x[c] - limb[k][c]) * e;
            length += e * e;
        }
        along = fmin(1.0, fmax(0.0, along / length));
        for (c = 0; c < 3; ++c) {
            const double d = x[c] - limb[k][c] - along * (limb[k][3 + c] - limb[k][c]);
            square += d * d;
        }
        sum += exp(-20 * (sqrt(square) - limb[k][6]));
    }
    return -log(sum) / 20;
}

#endif
