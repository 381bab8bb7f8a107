/* contact - what contact costs: a step of a body that lies on a floor over one of the same body held at those nodes.
 *
 * Corotational blocks on a floor under gravity, E = 1e6 Pa, nu = 0.3, h = 1/60 s, one thread. Steps of both bodies take turns in one
 * process; medians and worst of 181, when the block has settled. First touch: what a step takes in which all of
 * these nodes touch for the first time, over that median, and so much a node. Drop: the worst step of a block that falls on
 * the floor and back over the worst of one that falls past it.
 *
 *     contact [--quick]
 */
#include "../examples/support.h"
#include "bench.h"

enum { STEPS = 181, SETTLE = 60 };

typedef struct scene {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body, *held;
    sfem_contact *contact;
} scene;

static void open_scene(scene *s, sfem_int wide, sfem_int high, double above)
{
    static const double up[3] = {0, 0, 1}, origin[3] = {0, 0, 0};
    const sfem_int cells[3] = {wide, wide, high};
    const sfem_real size[3] = {0.5, 0.5, 0.5 * high / wide};
    const sfem_obstacle_def floor = sfem_obstacle_plane(up, origin);
    sfem_model_def model = sfem_default_model_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_int *pins, i;
    sfem_error err;
    memset(s, 0, sizeof *s);
    bench_must(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &s->mesh, &err), &err);
    pins = (sfem_int *)ex_new((size_t)s->mesh.nodes, sizeof *pins);
    for (i = 0; i < s->mesh.nodes; ++i) {
        if (s->mesh.x[3 * i + 2] < 1e-9) pins[def.pin_count++] = i;
        s->mesh.x[3 * i + 2] += above;
    }
    model.mesh = &s->mesh;
    model.material.young = 1e6;
    model.material.poisson = 0.3;
    model.material.law = SFEM_COROTATIONAL;
    bench_must(sfem_model_create(&model, &s->model, &err), &err);
    def.gravity[2] = -9.81;
    def.stiffness_damping = 0.01;
    def.pins = pins;
    bench_must(sfem_body_create(s->model, &def, &s->held, &err), &err);
    def.pins = NULL;
    def.pin_count = 0;
    bench_must(sfem_body_create(s->model, &def, &s->body, &err), &err);
    bench_must(sfem_contact_create(NULL, &s->contact, &err), &err);
    bench_must(sfem_contact_add_body(s->contact, s->body, NULL, ~0u, NULL, &err), &err);
    bench_must(sfem_contact_add_obstacle(s->contact, &floor, NULL, &err), &err);
    bench_must(sfem_body_prepare(s->body, 1.0 / 60, &err), &err);
    bench_must(sfem_body_prepare(s->held, 1.0 / 60, &err), &err);
    free(pins);
}

static void close_scene(scene *s)
{
    sfem_contact_free(s->contact);
    sfem_body_free(s->body);
    sfem_body_free(s->held);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

static double contact_step(scene *s)
{
    sfem_error err;
    const double t = bench_seconds();
    bench_must(sfem_contact_step(s->contact, 1.0 / 60, &err), &err);
    return bench_seconds() - t;
}

static double plain_step(sfem_body *body)
{
    sfem_error err;
    const double t = bench_seconds();
    bench_must(sfem_body_step(body, 1.0 / 60, &err), &err);
    return bench_seconds() - t;
}

static void lie(sfem_int wide, sfem_int high)
{
    double time[2][STEPS], first;
    sfem_contact_info info;
    int64_t solves, sweeps = 0;
    scene s;
    int k;
    open_scene(&s, wide, high, 0);
    first = contact_step(&s);
    for (k = 0; k < SETTLE; ++k) {
        (void)contact_step(&s);
        (void)plain_step(s.held);
    }
    solves = sfem_body_get_info(s.body).solves;
    for (k = 0; k < STEPS; ++k) {
        time[0][k] = plain_step(s.held);
        time[1][k] = contact_step(&s);
        sweeps += sfem_contact_get_info(s.contact).sweeps;
    }
    solves = sfem_body_get_info(s.body).solves - solves;
    info = sfem_contact_get_info(s.contact);
    for (k = 0; k < 2; ++k) qsort(time[k], STEPS, sizeof(double), bench_compare);
    printf("%7d %9d %10.0f %8.2f %8.2f %8.2f %8.1f %11.1f %10.0f %8.1f\n", (int)s.mesh.tets, (int)info.contacts,
           1e6 * time[0][STEPS / 2], time[1][STEPS / 2] / time[0][STEPS / 2], time[1][STEPS - 1] / time[0][STEPS - 1],
           (double)solves / STEPS, (double)sweeps / STEPS, first / time[0][STEPS / 2],
           1e6 * (first - time[1][STEPS / 2]) / (double)info.columns_made, (double)info.bytes / 1e6);
    close_scene(&s);
}

static void fall(sfem_int wide)
{
    double worst[2] = {0, 0};
    int past, k;
    for (past = 0; past < 2; ++past) {
        scene s;
        open_scene(&s, wide, wide, past ? 100 : 0.3);
        for (k = 0; k < 60; ++k) worst[past] = fmax(worst[past], contact_step(&s));
        close_scene(&s);
    }
    printf("drop of %d cells a side: worst step %.0f us, %.1f times that without floor\n", (int)wide, 1e6 * worst[0],
           worst[0] / worst[1]);
}

int main(int argc, char **argv)
{
    const int quick = argc > 1 && !strcmp(argv[1], "--quick");
    printf("   tets  contacts   plain us   median    worst   solves   sweeps first touch  us a node       MB\n");
    lie(8, 8);
    if (!quick) {
        lie(9, 6);
        lie(9, 50);
        lie(16, 16);
        lie(22, 8);
    }
    fall(8);
    return 0;
}
