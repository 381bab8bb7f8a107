/* A block of nx x ny x nz cells of five or six linear tetrahedra with one face clamped, and its
 * A = K h^2/4 + M: the matrices that the tests and benches of the solver work on. Assembled here
 * from scratch, so as not to depend on what is tested. */
#ifndef BLOCK_FEM_H
#define BLOCK_FEM_H

#include "softfem.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct block_fem {
    sfem_int n, tets;
    double *x;     /* [n][3] of the nodes that are not clamped */
    sfem_matrix a; /* K h^2/4 + M */
    sfem_matrix m; /* lumped mass, diagonal, on the same pattern */
} block_fem;

static int block_fem_invert(const double *a, double *b) /* 3x3, returns 0 if singular */
{
    const double d = a[0] * (a[4] * a[8] - a[5] * a[7]) - a[1] * (a[3] * a[8] - a[5] * a[6]) +
                     a[2] * (a[3] * a[7] - a[4] * a[6]);
    int i, j;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j) {
            const int p = (j + 1) % 3, q = (j + 2) % 3, r = (i + 1) % 3, s = (i + 2) % 3;
            b[3 * i + j] = (a[3 * p + r] * a[3 * q + s] - a[3 * p + s] * a[3 * q + r]) / d;
        }
    return d != 0;
}

/* K and lumped M of tets on nodes; nodes with clamp[i] are left out. map gets the new numbers. */
static block_fem block_fem_assemble(sfem_int nodes, const double *x, sfem_int tets,
                                    const sfem_int *tet, const unsigned char *clamp, double e,
                                    double nu, double rho, double k_factor, double m_factor)
{
    const double lambda = e * nu / ((1 + nu) * (1 - 2 * nu)), mu = e / (2 * (1 + nu));
    block_fem f;
    sfem_int *map = (sfem_int *)malloc(((size_t)nodes + 1) * sizeof *map), t, count = 0;
    sfem_int *bi = (sfem_int *)malloc((size_t)tets * 10 * sizeof *bi);
    sfem_int *bj = (sfem_int *)malloc((size_t)tets * 10 * sizeof *bj);
    double *bv = (double *)calloc((size_t)tets * 90, sizeof *bv);
    double *bm = (double *)calloc((size_t)tets * 90, sizeof *bm);
    memset(&f, 0, sizeof f);
    f.x = (double *)malloc((size_t)nodes * 3 * sizeof *f.x);
    for (t = 0; t < nodes; ++t) {
        map[t] = clamp[t] ? -1 : f.n;
        if (!clamp[t]) memcpy(f.x + 3 * (size_t)f.n++, x + 3 * (size_t)t, 3 * sizeof *x);
    }
    f.tets = tets;
    for (t = 0; t < tets; ++t) {
        const sfem_int *v = tet + 4 * (size_t)t;
        double d[9], g[9], grad[4][3], volume;
        int a, b, i, j;
        for (a = 0; a < 3; ++a)
            for (i = 0; i < 3; ++i) d[3 * a + i] = x[3 * v[a + 1] + i] - x[3 * v[0] + i];
        block_fem_invert(d, g); /* rows: directions, columns: edges */
        volume = fabs(d[0] * (d[4] * d[8] - d[5] * d[7]) - d[1] * (d[3] * d[8] - d[5] * d[6]) +
                      d[2] * (d[3] * d[7] - d[4] * d[6])) /
                 6;
        for (i = 0; i < 3; ++i) {
            grad[0][i] = 0;
            for (a = 0; a < 3; ++a) {
                grad[a + 1][i] = g[3 * i + a];
                grad[0][i] -= g[3 * i + a];
            }
        }
        for (a = 0; a < 4; ++a)
            for (b = 0; b <= a; ++b) {
                double dot = 0, *k, *m;
                if (map[v[a]] < 0 || map[v[b]] < 0) continue;
                bi[count] = map[v[a]];
                bj[count] = map[v[b]];
                k = bv + 9 * (size_t)count;
                m = bm + 9 * (size_t)count++;
                for (i = 0; i < 3; ++i) dot += grad[a][i] * grad[b][i];
                for (i = 0; i < 3; ++i)
                    for (j = 0; j < 3; ++j)
                        k[3 * i + j] = k_factor * volume *
                                       (lambda * grad[a][i] * grad[b][j] +
                                        mu * grad[a][j] * grad[b][i] + (i == j) * mu * dot);
                if (a == b)
                    for (i = 0; i < 3; ++i) {
                        m[4 * i] = rho * volume / 4;
                        k[4 * i] += m_factor * m[4 * i];
                    }
            }
    }
    sfem_matrix_create(f.n, count, bi, bj, bv, NULL, &f.a, NULL);
    sfem_matrix_create(f.n, count, bi, bj, bm, NULL, &f.m, NULL);
    free(map);
    free(bi);
    free(bj);
    free(bv);
    free(bm);
    return f;
}

/* cells of size 1/nz; five = 1: mirrored five-tet cells, 0: six tets around a diagonal. */
static __attribute__((unused)) block_fem block_fem_create(sfem_int nx, sfem_int ny, sfem_int nz, int five)
{
    static const int corner[8][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0},
                                     {0, 0, 1}, {1, 0, 1}, {0, 1, 1}, {1, 1, 1}};
    static const int cut5[5][4] = {
        {0, 1, 2, 4}, {1, 3, 2, 7}, {1, 4, 7, 5}, {2, 7, 4, 6}, {1, 2, 4, 7}};
    static const int cut6[6][4] = {{0, 1, 3, 7}, {0, 3, 2, 7}, {0, 2, 6, 7},
                                   {0, 6, 4, 7}, {0, 4, 5, 7}, {0, 5, 1, 7}};
    const sfem_int nodes = (nx + 1) * (ny + 1) * (nz + 1), per = five ? 5 : 6;
    double *x = (double *)malloc((size_t)nodes * 3 * sizeof *x);
    unsigned char *clamp = (unsigned char *)calloc((size_t)nodes, 1);
    sfem_int *tet = (sfem_int *)malloc((size_t)(nx * ny * nz * per) * 4 * sizeof *tet);
    sfem_int i, j, k, count = 0;
    const double h = 1. / 60;
    block_fem f;
    int c, v;
    for (k = 0; k <= nz; ++k)
        for (j = 0; j <= ny; ++j)
            for (i = 0; i <= nx; ++i) {
                const sfem_int at = i + (nx + 1) * (j + (ny + 1) * k);
                x[3 * at] = (double)i / nz;
                x[3 * at + 1] = (double)j / nz;
                x[3 * at + 2] = (double)k / nz;
                clamp[at] = i == 0;
            }
    for (k = 0; k < nz; ++k)
        for (j = 0; j < ny; ++j)
            for (i = 0; i < nx; ++i)
                for (c = 0; c < per; ++c, ++count)
                    for (v = 0; v < 4; ++v) {
                        const int *o = corner[five ? cut5[c][v] : cut6[c][v]];
                        sfem_int p = i + o[0], q = j + o[1], r = k + o[2];
                        if (five && (i + j + k) % 2)
                            p = i + 1 - o[0]; /* every other cell mirrored */
                        tet[4 * count + v] = p + (nx + 1) * (q + (ny + 1) * r);
                    }
    f = block_fem_assemble(nodes, x, count, tet, clamp, 1e6, .45, 1000, h * h / 4, 1);
    free(x);
    free(clamp);
    free(tet);
    return f;
}

static void block_fem_free(block_fem *f)
{
    sfem_matrix_free(&f->a);
    sfem_matrix_free(&f->m);
    free(f->x);
    memset(f, 0, sizeof *f);
}

#endif
