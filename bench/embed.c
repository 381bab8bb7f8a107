/* embed - what a render surface that follows a coarse body costs a point.
 *
 * Balls of 20 rings^3 tets, spheres of 2 n^2 points at 0.99 of their radius (outside of them at 1.02). The
 * nodes are displaced at random. Floats at a stride of 32 bytes, as a vertex of place, normal and texture has it; one
 * thread; medians of 31 processor times. Beside it a copy of as much memory as an application reads and writes: 72 bytes
 * a point read, 32 written, with normals 28 more and 48 for each node.
 *
 *     embed [--quick]
 */
#include "../examples/support.h"
#include "bench.h"

enum { REPEATS = 31, STRIDE = 32 };

/* A sphere in n rings of 2 n points, and its triangles: the poles are rings of points at one place. */
static sfem_int sphere(sfem_int n, double radius, double **x, sfem_int **tri, sfem_int *triangles)
{
    const sfem_int wide = 2 * n;
    sfem_int i, j;
    *x = (double *)ex_new(3 * (size_t)(n * wide), sizeof **x);
    *tri = (sfem_int *)ex_new(6 * (size_t)((n - 1) * wide), sizeof **tri);
    *triangles = 0;
    for (i = 0; i < n; ++i)
        for (j = 0; j < wide; ++j) {
            const double pi = 3.14159265358979323846, a = pi * i / (n - 1), b = pi * j / n;
            double *p = *x + 3 * (size_t)(i * wide + j);
            sfem_int *t = *tri + 3 * (size_t)*triangles, next = (j + 1) % wide;
            p[0] = radius * sin(a) * cos(b);
            p[1] = radius * sin(a) * sin(b);
            p[2] = radius * cos(a);
            if (i + 1 == n) continue;
            t[0] = i * wide + j, t[1] = (i + 1) * wide + j, t[2] = (i + 1) * wide + next;
            t[3] = t[0], t[4] = t[2], t[5] = i * wide + next;
            *triangles += 2;
        }
    return n * wide;
}

static double apply(sfem_embed *e, const double *u, float *x, float *n)
{
    double time[REPEATS], start;
    int k;
    sfem_embed_to_floats(e, u, x, n, STRIDE);
    for (k = 0; k < REPEATS; ++k) {
        start = bench_seconds();
        sfem_embed_to_floats(e, u, x, n, STRIDE);
        time[k] = bench_seconds() - start;
    }
    return bench_median(time, REPEATS);
}

/* Seconds to read and write so many bytes in all. */
static double copy(size_t bytes)
{
    char *from = (char *)malloc(bytes), *to = from + bytes / 2;
    double time[REPEATS], start;
    int k;
    if (!from) exit(2);
    memset(from, 1, bytes);
    for (k = 0; k < REPEATS; ++k) {
        start = bench_seconds();
        memcpy(to, from, bytes / 2);
        time[k] = bench_seconds() - start;
        from[k] ^= to[k];
    }
    free(from);
    return bench_median(time, REPEATS);
}

static void row(sfem_int rings, sfem_int fine, double radius)
{
    sfem_embed_def def = sfem_default_embed_def();
    sfem_int *tri;
    sfem_mesh m;
    sfem_embed *e;
    sfem_error err;
    double *x, *u, made, place, both, memory, more;
    float *out;
    sfem_int i;
    bench_must(sfem_mesh_ball(1, rings, NULL, &m, &err), &err);
    def.points = sphere(fine, radius, &x, &tri, &def.triangles);
    def.x = x;
    def.tri = tri;
    u = (double *)malloc(3 * (size_t)m.nodes * sizeof *u);
    out = (float *)malloc((size_t)def.points * STRIDE);
    if (!u || !out) exit(2);
    for (i = 0; i < 3 * m.nodes; ++i) u[i] = 1e-3 * sin(12.9 * i);
    made = bench_seconds();
    bench_must(sfem_embed_create(&m, &def, &e, &err), &err);
    made = bench_seconds() - made;
    place = apply(e, u, out, NULL);
    both = apply(e, u, out, out + 3);
    memory = copy((size_t)def.points * (72 + 32));
    more = copy((size_t)def.points * (72 + 32 + 28) + (size_t)m.nodes * 48);
    printf("%8d %9d %8d %10.0f %9.1f %9.1f %9.1f %9.1f\n", (int)m.tets, (int)def.points,
           (int)sfem_embed_get_info(e).outside, 1e9 * made / def.points, 1e9 * place / def.points,
           1e9 * memory / def.points, 1e9 * both / def.points, 1e9 * more / def.points);
    sfem_embed_free(e);
    free(tri);
    sfem_mesh_free(&m);
    free(out);
    free(u);
    free(x);
}

int main(int argc, char **argv)
{
    const int quick = argc > 1 && !strcmp(argv[1], "--quick");
    printf("%s\nns a point\n%8s %9s %8s %10s %9s %9s %9s %9s\n", SFEM_BENCH_FLAGS, "tets", "points", "outside", "create",
           "places", "copy", "+normals", "copy");
    row(5, 70, 0.97);
    row(10, 70, 0.99);
    row(10, 224, 0.99);
    row(10, 224, 1.02);
    if (!quick) row(20, 707, 0.99);
    return 0;
}
