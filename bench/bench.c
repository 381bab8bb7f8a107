/* bench - what a body costs: set-up, factor, solve, step and memory by size.
 *
 * Block meshes of five-tet cells, one face clamped, E = 1e6 Pa, nu = 0.45, h = 1/60 s, (p,q,r) with
 * p = 1/4, one thread, time of the processor. Each figure is the median of repeated runs in one process; the first of each is not
 * counted. The ceiling beside them is this machine's, measured in the same run: adding two arrays that
 * fit no cache, chains of multiply-adds, and of fused ones of four. Writes build/bench/bench.csv.
 *
 *     bench [--quick] [LARGEST]     sizes up to LARGEST tets, 54880 by default
 */
#include "../examples/support.h"
#include "bench.h"
#include "../tests/linear.h"

enum { REPEATS = 31 };

typedef struct result {
    sfem_int tets, dofs;
    double mesh, model, first, again, predict, solve, finish, step, mixed; /* seconds, medians */
    double nnz, model_mb, factor_mb, body_mb;
} result;

static void *counted(size_t bytes, void *user)
{
    *(size_t *)user += bytes;
    return malloc(bytes);
}

static void uncounted(void *memory, void *user)
{
    (void)user;
    free(memory);
}

static sfem_body *make_body(sfem_model *model, sfem_int pin_count, sfem_precision precision,
                            double h)
{
    sfem_int *pins = (sfem_int *)ex_new((size_t)pin_count, sizeof *pins), i;
    sfem_body_def def = sfem_default_body_def();
    sfem_body *body;
    sfem_error err;
    for (i = 0; i < pin_count; ++i) pins[i] = i;
    def.pins = pins;
    def.pin_count = pin_count;
    def.gravity[2] = -9.81;
    def.precision = precision;
    bench_must(sfem_body_create(model, &def, &body, &err), &err);
    bench_must(sfem_body_prepare(body, h, &err), &err);
    free(pins);
    return body;
}

static double time_steps(sfem_body *body, double h, int count, double part[3])
{
    double t[4][REPEATS * 10];
    sfem_error err;
    int i;
    for (i = -2; i < count; ++i) {
        const double a = bench_seconds();
        double b, c, d;
        bench_must(sfem_body_predict(body, h, &err), &err);
        b = bench_seconds();
        bench_must(sfem_body_solve(body, &err), &err);
        c = bench_seconds();
        bench_must(sfem_body_finish(body, &err), &err);
        d = bench_seconds();
        if (i < 0) continue;
        t[0][i] = b - a;
        t[1][i] = c - b;
        t[2][i] = d - c;
        t[3][i] = d - a;
    }
    for (i = 0; part && i < 3; ++i) part[i] = bench_median(t[i], count);
    return bench_median(t[3], count);
}

static result measure(const sfem_int cells[3], int repeats)
{
    const sfem_real size[3] = {cells[0] * 0.05, cells[1] * 0.05, cells[2] * 0.05};
    const sfem_int pins = (cells[1] + 1) * (cells[2] + 1);
    const double h = 1 / 60.0;
    double t[4][REPEATS], part[3];
    size_t model_bytes = 0;
    sfem_model_def def = linear_model_def();
    sfem_body_info info;
    sfem_body *body = NULL, *other;
    sfem_model *model = NULL;
    sfem_mesh mesh;
    sfem_error err;
    result r;
    int i;
    memset(&r, 0, sizeof r);
    def.material.poisson = 0.45;
    def.allocator.allocate = counted;
    def.allocator.release = uncounted;
    def.allocator.user = &model_bytes;
    for (i = 0; i <= repeats; ++i) {
        double a = bench_seconds();
        bench_must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
        if (i) t[0][i - 1] = bench_seconds() - a;
        def.mesh = &mesh;
        model_bytes = 0;
        a = bench_seconds();
        bench_must(sfem_model_create(&def, &model, &err), &err);
        if (i) t[1][i - 1] = bench_seconds() - a;
        r.model_mb = (double)model_bytes / 1e6;
        a = bench_seconds();
        body = make_body(model, pins, SFEM_DOUBLE, h);
        if (i) t[2][i - 1] = bench_seconds() - a;
        a = bench_seconds(); /* another step, so another matrix, on the same analysis */
        other = make_body(model, pins, SFEM_DOUBLE, 0.9 * h);
        if (i) t[3][i - 1] = bench_seconds() - a;
        sfem_body_free(other);
        r.tets = mesh.tets;
        sfem_mesh_free(&mesh);
        sfem_model_free(model); /* the body holds it */
        if (i < repeats) sfem_body_free(body);
    }
    r.mesh = bench_median(t[0], repeats);
    r.model = bench_median(t[1], repeats);
    r.first = bench_median(t[2], repeats);
    r.again = bench_median(t[3], repeats);
    r.step = time_steps(body, h, 10 * repeats, part);
    r.predict = part[0];
    r.solve = part[1];
    r.finish = part[2];
    info = sfem_body_get_info(body);
    r.dofs = 3 * info.free_nodes;
    r.nnz = (double)info.factor_nnz;
    r.factor_mb = (double)info.factor_bytes / 1e6;
    r.body_mb = (double)info.body_bytes / 1e6;
    other = make_body(model, pins, SFEM_MIXED, h);
    r.mixed = time_steps(other, h, 10 * repeats, NULL);
    sfem_body_free(other);
    sfem_body_free(body);
    return r;
}

enum { TRIES = 7 };

/* A ceiling is what the best of some runs reaches; others may be at work on the machine. */
static double least(const double *t)
{
    double best = t[0];
    int k;
    for (k = 1; k < TRIES; ++k) best = t[k] < best ? t[k] : best;
    return best;
}

/* Fused multiply-adds of 4 doubles that wait for nothing: GFLOP/s; 0 where the processor or the compiler has none. */
#if defined(__GNUC__) && defined(__x86_64__)
#include <immintrin.h>
__attribute__((target("avx2,fma"))) static double vector_flops(void)
{
    const __m256d a = _mm256_set1_pd(0.999999), b = _mm256_set1_pd(1e-7);
    __m256d x[12];
    double t[TRIES], out[4], sum = 0;
    int k, i, j;
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) return 0;
    for (j = 0; j < 12; ++j) x[j] = _mm256_set1_pd(1 + 0.1 * j);
    for (k = 0; k < TRIES; ++k) {
        const double start = bench_seconds();
        for (i = 0; i < 4000000; ++i) {
            x[0] = _mm256_fmadd_pd(x[0], a, b), x[1] = _mm256_fmadd_pd(x[1], a, b), x[2] = _mm256_fmadd_pd(x[2], a, b);
            x[3] = _mm256_fmadd_pd(x[3], a, b), x[4] = _mm256_fmadd_pd(x[4], a, b), x[5] = _mm256_fmadd_pd(x[5], a, b);
            x[6] = _mm256_fmadd_pd(x[6], a, b), x[7] = _mm256_fmadd_pd(x[7], a, b), x[8] = _mm256_fmadd_pd(x[8], a, b);
            x[9] = _mm256_fmadd_pd(x[9], a, b), x[10] = _mm256_fmadd_pd(x[10], a, b), x[11] = _mm256_fmadd_pd(x[11], a, b);
        }
        t[k] = bench_seconds() - start;
    }
    for (j = 0; j < 12; ++j) {
        _mm256_storeu_pd(out, x[j]);
        sum += out[0];
    }
    return sum > 0 ? 96e-9 * 4000000 / least(t) : 0;
}
#else
static double vector_flops(void) { return 0; }
#endif

/* What this machine can do at most, now: bytes and multiply-adds a second. */
static void print_ceiling(void)
{
    const size_t n = 8u << 20;
    double *a = (double *)ex_new(n, sizeof *a), *b = (double *)ex_new(n, sizeof *b), t[2][TRIES], x[16],
           sum = 0;
    size_t i;
    int k, j;
    for (k = 0; k < TRIES; ++k) {
        double start = bench_seconds();
        for (i = 0; i < n; ++i) a[i] += 0.5 * b[i];
        t[0][k] = bench_seconds() - start;
        for (j = 0; j < 16; ++j) x[j] = 1 + 1e-9 * j + a[(size_t)j];
        start = bench_seconds();
        for (i = 0; i < 20000000; ++i)
            for (j = 0; j < 16; ++j) x[j] = x[j] * 0.999999 + 1e-7;
        t[1][k] = bench_seconds() - start;
        for (j = 0; j < 16; ++j) sum += x[j];
    }
    printf("ceiling: memory %.1f GB/s, multiply-add as compiled here %.1f GFLOP/s, fused and 4 wide %.1f GFLOP/s%s\n",
           24e-9 * (double)n / least(t[0]), 32e-9 * 20000000 / least(t[1]), vector_flops(),
           sum > 1e300 ? " " : "");
    free(a);
    free(b);
}

static void print_machine(void)
{
    char line[256];
    FILE *f = fopen("/proc/cpuinfo", "r");
    while (f && fgets(line, sizeof line, f))
        if (!strncmp(line, "model name", 10)) {
            printf("machine:%s", strchr(line, ':') + 1);
            break;
        }
    if (f) fclose(f);
    printf("flags: %s, compiler %s\n", SFEM_BENCH_FLAGS, __VERSION__);
    print_ceiling();
}

int main(int argc, char **argv)
{
    static const sfem_int cells[][3] = {{12, 3, 3},   {20, 5, 5},   {28, 7, 7},
                                        {40, 10, 10}, {56, 14, 14}, {80, 20, 20}};
    const int quick = argc > 1 && !strcmp(argv[1], "--quick");
    const long largest = argc > 1 && !quick ? atol(argv[1]) : quick ? 2500 : 54880;
    FILE *csv;
    size_t i;
    ex_make_directory("build/bench");
    csv = ex_open("build/bench/bench.csv");
    print_machine();
    printf("\n%7s %7s | %8s %8s %8s %8s | %8s %8s %8s %8s %8s | %8s %7s %7s %7s\n", "tets", "dofs",
           "mesh ms", "model ms", "first ms", "again ms", "predict", "solve us", "finish",
           "step us", "mixed us", "nnz(L)", "model", "factor", "body MB");
    fprintf(csv, "tets,dofs,mesh_ms,model_ms,first_ms,again_ms,predict_us,solve_us,finish_us,step_"
                 "us,mixed_us,"
                 "nnz,model_mb,factor_mb,body_mb\n");
    for (i = 0; i < sizeof cells / sizeof *cells; ++i) {
        const long tets = 5L * cells[i][0] * cells[i][1] * cells[i][2];
        result r;
        if (tets > largest) break;
        r = measure(cells[i], tets > 100000 ? 3 : tets > 10000 ? 7 : REPEATS);
        printf("%7d %7d | %8.3f %8.3f %8.3f %8.3f | %8.1f %8.1f %8.1f %8.1f %8.1f | %8.3g %7.2f "
               "%7.2f %7.2f\n",
               (int)r.tets, (int)r.dofs, 1e3 * r.mesh, 1e3 * r.model, 1e3 * r.first, 1e3 * r.again,
               1e6 * r.predict, 1e6 * r.solve, 1e6 * r.finish, 1e6 * r.step, 1e6 * r.mixed, r.nnz,
               r.model_mb, r.factor_mb, r.body_mb);
        fflush(stdout);
        fprintf(csv, "%d,%d,%g,%g,%g,%g,%g,%g,%g,%g,%g,%g,%g,%g,%g\n", (int)r.tets, (int)r.dofs,
                1e3 * r.mesh, 1e3 * r.model, 1e3 * r.first, 1e3 * r.again, 1e6 * r.predict,
                1e6 * r.solve, 1e6 * r.finish, 1e6 * r.step, 1e6 * r.mixed, r.nnz, r.model_mb,
                r.factor_mb, r.body_mb);
    }
    ex_close(csv, "build/bench/bench.csv");
    printf("\nfirst: the first body's ordering, analysis and factor; again: a factor on the same "
           "analysis.\n"
           "model memory is all that its creation asked for, scratch included. wrote "
           "build/bench/bench.csv\n");
    return 0;
}
