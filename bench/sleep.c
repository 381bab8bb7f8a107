/* sleep - what a step costs asleep, and what watching for sleep costs awake.
 *
 * Block meshes, one face clamped, gravity, E = 1e6 Pa, h = 1/60 s, one thread. Awake steps with and without
 * sleep_tolerance take turns in one process, moving (the look at velocities ends at the first fast node) and
 * calm (it sees them all; sleep_time keeps the body awake); medians of 301. Asleep: the mean over a
 * million steps.
 *
 *     sleep [--quick]
 */
#include "../examples/support.h"
#include "bench.h"
#include "../tests/linear.h"

enum { STEPS = 301 };

static double step(sfem_body *body)
{
    sfem_error err;
    const double t = ex_seconds();
    bench_must(sfem_body_step(body, 1.0 / 60, &err), &err);
    return ex_seconds() - t;
}

/* seconds a step of a plain body and of one that is watched */
static void awake(sfem_model *model, sfem_body_def def, double tolerance, double out[2])
{
    double time[2][STEPS];
    sfem_body *body[2];
    sfem_error err;
    int i, k;
    for (i = 0; i < 2; ++i) {
        def.sleep_tolerance = i ? tolerance : 0;
        def.sleep_time = 1e9;
        bench_must(sfem_body_create(model, &def, &body[i], &err), &err);
        (void)step(body[i]);
    }
    for (k = 0; k < STEPS; ++k)
        for (i = 0; i < 2; ++i) time[i][k] = step(body[i]);
    for (i = 0; i < 2; ++i) {
        qsort(time[i], STEPS, sizeof(double), bench_compare);
        out[i] = time[i][STEPS / 2];
        sfem_body_free(body[i]);
    }
}

static double asleep(sfem_model *model, sfem_body_def def, int steps)
{
    sfem_body *body;
    sfem_error err;
    double t;
    int k;
    def.sleep_tolerance = 1e9; /* any speed will do, */
    def.sleep_time = 0;        /* at once, */
    def.gravity[1] = 0;        /* for velocities that do not change */
    bench_must(sfem_body_create(model, &def, &body, &err), &err);
    for (k = 0; !sfem_body_is_asleep(body); ++k) (void)step(body);
    t = ex_seconds();
    for (k = 0; k < steps; ++k) bench_must(sfem_body_step(body, 1.0 / 60, &err), &err);
    t = ex_seconds() - t;
    sfem_body_free(body);
    return t / steps;
}

int main(int argc, char **argv)
{
    const sfem_int cells[] = {4, 10, 20};
    const int quick = argc > 1 && !strcmp(argv[1], "--quick");
    int size, law;
    printf("%-13s %8s %14s %14s %14s %12s\n", "law", "tets", "awake", "watched moving",
           "watched calm", "asleep");
    for (law = SFEM_LINEAR; law <= SFEM_COROTATIONAL; ++law)
        for (size = 0; size < (quick ? 1 : 3); ++size) {
            const sfem_int count[3] = {3 * cells[size], cells[size], cells[size]};
            const sfem_real length[3] = {3, 1, 1};
            sfem_model_def model_def = linear_model_def();
            sfem_body_def def = sfem_default_body_def();
            sfem_int pins[512], i;
            sfem_mesh mesh;
            sfem_model *model;
            sfem_error err;
            double moving[2], calm[2], still;
            bench_must(sfem_mesh_block(count, length, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
            for (i = 0; i < mesh.nodes && def.pin_count < 512; ++i)
                if (mesh.x[3 * i] < 1e-9) pins[def.pin_count++] = i;
            model_def.mesh = &mesh;
            model_def.material.young = 1e6;
            model_def.material.law = (sfem_law)law;
            bench_must(sfem_model_create(&model_def, &model, &err), &err);
            def.pins = pins;
            def.gravity[1] = -9.8;
            awake(model, def, 1e-3, moving);
            awake(model, def, 1e3, calm);
            still = asleep(model, def, 1000000);
            printf("%-13s %8d %11.1f us %+12.2f %% %+12.2f %% %9.1f ns\n",
                   law ? "corotational" : "linear", (int)mesh.tets, moving[0] * 1e6,
                   (moving[1] / moving[0] - 1) * 100, (calm[1] / calm[0] - 1) * 100, still * 1e9);
            sfem_model_free(model);
            sfem_mesh_free(&mesh);
        }
    return 0;
}
