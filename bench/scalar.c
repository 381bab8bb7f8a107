/* scalar - a matrix S (x) I by its n x n factor and by that of its 3x3 blocks.
 *
 * S = mass + 100 Laplacian of block meshes, as (p,q,r) has it with the isotropic majorant. Bytes of the factor
 * and of all, the time of sfem_ldl_create and of a solve for n x 3 numbers: three right sides or one.
 * Medians of 5 and 101 that take turns; how far the two solutions are apart.
 *
 *     scalar [--quick] [--mixed]
 */
#include "../examples/support.h"
#include "bench.h"
#include "../tests/linear.h"

enum { MAKE = 5, SOLVE = 101 };

/* The model's K has in its blocks' traces (lambda + 4 mu) V g_a.g_b: the Laplacian but for a factor. */
static void fill(const sfem_matrix *k, const sfem_matrix *m, sfem_real *scalar, sfem_real *block)
{
    sfem_int i, at;
    int c;
    for (i = 0; i < k->n; ++i)
        for (at = k->row[i]; at < k->row[i + 1]; ++at) {
            const sfem_real *b = k->val + 9 * at;
            scalar[at] = 100 * (b[0] + b[4] + b[8]) + m->val[9 * at];
            for (c = 0; c < 9; ++c) block[9 * at + c] = c % 4 ? 0 : scalar[at];
        }
}

static void measure(const sfem_mesh *mesh, sfem_model *model, int mixed)
{
    sfem_matrix k, m, a[2];
    sfem_ldl *ldl[2] = {NULL, NULL};
    sfem_ldl_info info[2];
    double make[2][MAKE], solve[2][SOLVE], far = 0, size = 0;
    const size_t n = (size_t)mesh->nodes;
    sfem_real *x[2], *work[2];
    sfem_error err;
    size_t i;
    int which, r, c;
    bench_must(sfem_model_combine(model, 1, 0, 0, NULL, &k, &err), &err);
    bench_must(sfem_model_combine(model, 0, 1, 0, NULL, &m, &err), &err);
    a[0] = a[1] = k;
    a[0].val = (sfem_real *)ex_new((size_t)k.row[k.n], sizeof(sfem_real));
    a[1].val = (sfem_real *)ex_new(9 * (size_t)k.row[k.n], sizeof(sfem_real));
    fill(&k, &m, a[0].val, a[1].val);
    for (r = 0; r < MAKE; ++r)
        for (which = 0; which < 2; ++which) {
            sfem_ldl_def def = sfem_default_ldl_def();
            const double t = ex_seconds();
            def.x = mesh->x;
            def.scalar = which == 0;
            def.precision = mixed ? SFEM_MIXED : SFEM_DOUBLE;
            sfem_ldl_free(ldl[which]);
            bench_must(sfem_ldl_create(&def, &a[which], &ldl[which], &err), &err);
            make[which][r] = ex_seconds() - t;
        }
    for (which = 0; which < 2; ++which) {
        info[which] = sfem_ldl_get_info(ldl[which]);
        x[which] = (sfem_real *)ex_new(3 * n, sizeof(sfem_real));
        work[which] = (sfem_real *)ex_new(sfem_ldl_work_size(ldl[which], 3), sizeof(sfem_real));
    }
    for (r = 0; r < SOLVE; ++r)
        for (which = 0; which < 2; ++which) {
            double t;
            for (i = 0; i < n; ++i)
                for (c = 0; c < 3; ++c)
                    x[which][which ? 3 * i + (size_t)c : (size_t)c * n + i] =
                        sin((double)(3 * i + (size_t)c));
            t = ex_seconds();
            sfem_ldl_solve(ldl[which], which ? 1 : 3, x[which], work[which], NULL);
            solve[which][r] = ex_seconds() - t;
        }
    for (i = 0; i < n; ++i)
        for (c = 0; c < 3; ++c) {
            const double d = fabs(x[0][(size_t)c * n + i] - x[1][3 * i + (size_t)c]);
            if (d > far) far = d;
            if (fabs(x[0][(size_t)c * n + i]) > size) size = fabs(x[0][(size_t)c * n + i]);
        }
    printf("%8d %9.2f %9.2f %6.2f  %9.2f %9.2f %6.2f  %9.1f %9.1f %6.2f  %.1e\n", (int)mesh->tets,
           (double)info[1].bytes / 1e6, (double)info[0].bytes / 1e6,
           (double)info[1].bytes / (double)info[0].bytes, bench_median(make[1], MAKE) * 1e3,
           bench_median(make[0], MAKE) * 1e3,
           bench_median(make[1], MAKE) / bench_median(make[0], MAKE),
           bench_median(solve[1], SOLVE) * 1e6, bench_median(solve[0], SOLVE) * 1e6,
           bench_median(solve[1], SOLVE) / bench_median(solve[0], SOLVE), far / size);
    for (which = 0; which < 2; ++which) {
        sfem_ldl_free(ldl[which]);
        free(x[which]);
        free(work[which]);
        free(a[which].val);
    }
    sfem_matrix_free(&k);
    sfem_matrix_free(&m);
}

int main(int argc, char **argv)
{
    const sfem_int cells[] = {2, 4, 7, 10, 16, 22};
    int quick = 0, mixed = 0, size;
    for (; argc > 1; --argc) {
        if (!strcmp(argv[argc - 1], "--quick"))
            quick = 1;
        else if (!strcmp(argv[argc - 1], "--mixed"))
            mixed = 1;
        else
            ex_fail("scalar [--quick] [--mixed]");
    }
    printf("%8s %26s  %26s  %26s\n%8s %9s %9s %6s  %9s %9s %6s  %9s %9s %6s  %s\n", "", "bytes, MB",
           "create, ms", "solve, us", "tets", "3x3", "n x n", "ratio", "3x3", "n x n", "ratio",
           "3x3", "n x n", "ratio", "difference");
    for (size = 0; size < (quick ? 2 : 6); ++size) {
        const sfem_int count[3] = {3 * cells[size], cells[size], cells[size]};
        const sfem_real length[3] = {3, 1, 1};
        sfem_model_def def = linear_model_def();
        sfem_mesh mesh;
        sfem_model *model;
        sfem_error err;
        bench_must(sfem_mesh_block(count, length, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
        def.mesh = &mesh;
        def.material.young = 1;
        def.material.density = 1;
        bench_must(sfem_model_create(&def, &model, &err), &err);
        measure(&mesh, model, mixed);
        sfem_model_free(model);
        sfem_mesh_free(&mesh);
    }
    return 0;
}
