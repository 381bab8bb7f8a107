/* State blocks with a right checksum and wrong contents; and the targets of fuzz.h under a fixed sequence of mutations,
 * a second each at most: what `make fuzz` does at length. */
#define SFEM_STATIC
#define SOFTFEM_IMPLEMENTATION
#include "support.h"

#include <time.h>

#include "fuzz.h"

/* --------------------------------------------------------------------------------------------
 * blocks that were found to crash or that go on with nonsense
 * -------------------------------------------------------------------------------------------- */

/* A modal body, and its block with two handles, the second of three nodes, and four forces. */
typedef struct modal_block {
    sfem_modal *body, *view; /* view: another body's pointers, into the block */
    unsigned char *block;
    size_t bytes;
} modal_block;

static modal_block make_modal_block(int scene)
{
    modal_block m;
    sfemi_modal_shape shape;
    const unsigned char *good = fuzz_modal_block(scene, 1, &m.bytes);
    m.body = fuzz_modal(fuzz_reduced(scene > 1), scene);
    m.view = (sfem_modal *)malloc(sizeof *m.view);
    *m.view = *m.body;
    m.block = (unsigned char *)malloc(m.bytes);
    memcpy(m.block, good, m.bytes);
    shape = sfemi_modal_shape_of(m.body);
    assert_int_equal(sfemi_saved_lay_out(&sfemi_modal_kind, &shape, m.view, m.block), m.bytes);
    return m;
}

static void drop_modal_block(modal_block *m)
{
    sfem_modal_free(m->body);
    free(m->view);
    free(m->block);
}

/* Refused with a text that names the thing, the body as it was. Puts the good block back. */
static void refuse_modal(modal_block *m, const char *words)
{
    void *before = malloc(2 * m->bytes), *after = (char *)before + m->bytes;
    size_t bytes;
    sfem_error err;
    sfemi_saved_seal(m->block);
    sfem_modal_save_state(m->body, before);
    assert_status(sfem_modal_load_state(m->body, m->block, m->bytes, &err), SFEM_FORMAT);
    assert_names(err, words);
    sfem_modal_save_state(m->body, after);
    assert_memory_equal(before, after, m->bytes);
    free(before);
    memcpy(m->block, fuzz_modal_block(0, 1, &bytes), m->bytes);
}

static void a_modal_block_with_handles_or_forces_out_of_order_is_refused(void **state)
{
    modal_block m = make_modal_block(0);
    const sfem_modal *v = m.view;
    const sfem_real f[3] = {1, 1, 1};
    sfem_error err;
    sfem_int i;
    (void)state;
    v->force_node[1] = v->force_node[0]; /* twice: adding a force to every other node would run over the end */
    refuse_modal(&m, "a force");
    v->handle[1].first = 0; /* overlaps the first: released one after the other, a negative size would move */
    refuse_modal(&m, "a handle");
    v->handle[1].count = 2; /* one place belongs to nobody */
    refuse_modal(&m, "a handle");
    v->handle[1].first = INT32_MAX;
    refuse_modal(&m, "a handle");
    v->handle[1].used = 0; /* fewer than the head says */
    refuse_modal(&m, "a handle");
    v->head->handles = -1;
    refuse_modal(&m, "its head");
    v->handle_node[3] = 12;
    refuse_modal(&m, "a handle");
    v->weight[2] = NAN;
    refuse_modal(&m, "a handle");
    v->force[4] = INFINITY;
    refuse_modal(&m, "a force");
    sfemi_saved_seal(m.block);
    assert_ok(sfem_modal_load_state(m.body, m.block, m.bytes, &err), err);
    for (i = 0; i < 12; ++i) assert_ok(sfem_modal_add_lasting_force(m.body, i, f, &err), err);
    drop_modal_block(&m);
}

static void a_modal_block_with_a_number_that_is_not_finite_is_refused(void **state)
{
    modal_block m = make_modal_block(0);
    const sfem_modal *v = m.view;
    (void)state;
    v->head->gravity[2] = NAN; /* the last of them, too */
    refuse_modal(&m, "its head");
    v->head->h = -2;
    refuse_modal(&m, "its head");
    v->head->steps = INT64_MAX; /* one more would overflow */
    refuse_modal(&m, "its head");
    v->f[0] = NAN;
    refuse_modal(&m, "a mode");
    v->rest[1] = NAN;
    refuse_modal(&m, "a mode");
    v->mean[2] = INFINITY;
    refuse_modal(&m, "a mode");
    drop_modal_block(&m);
}

static void a_reduced_block_with_a_number_out_of_its_range_is_refused(void **state)
{
    sfem_reduced *good = fuzz_reduced(0), view = *good, *loaded = NULL;
    const size_t bytes = sfem_reduced_size(good);
    void *block = malloc(bytes);
    sfem_error err;
    int k;
    (void)state;
    assert_int_equal(sfemi_saved_lay_out(&sfemi_reduced_kind, good->head, &view, block), bytes);
    for (k = 0; k < 7; ++k) {
        memcpy(block, good->head, bytes);
        if (k == 0) view.head->free = 2;
        if (k == 1) view.mass[3] = NAN;
        if (k == 2) view.gain[1] = NAN;
        if (k == 3) view.gravity[4] = INFINITY;
        if (k == 4) view.group_phi[2] = NAN;
        if (k == 5) view.group_psi[7] = NAN;
        if (k == 6) view.amplitude[0] = INFINITY;
        sfemi_saved_seal(block);
        assert_status(sfem_reduced_load(block, bytes, NULL, &loaded, &err), SFEM_FORMAT);
        assert_names(err, "out of their ranges");
    }
    free(block);
}

/* A body and its block, as above. */
typedef struct body_block {
    const fuzz_scene *scene;
    sfem_body *body;
    unsigned char *block;
    sfemi_state view; /* into the block */
} body_block;

static body_block make_body_block(int scene)
{
    body_block m;
    sfemi_state_shape shape;
    sfem_error err;
    m.scene = fuzz_body_scene(scene);
    m.block = (unsigned char *)malloc(m.scene->bytes);
    assert_ok(sfem_body_create(m.scene->model, &m.scene->def, &m.body, &err), err);
    memcpy(m.block, m.scene->block[2], m.scene->bytes);
    shape = sfemi_body_state_shape(m.body, m.body->pin_count);
    assert_int_equal(sfemi_saved_lay_out(&sfemi_state_kind, &shape, &m.view, m.block), m.scene->bytes);
    return m;
}

static void drop_body_block(body_block *m)
{
    sfem_body_free(m->body);
    free(m->block);
}

static void refuse_body(body_block *m, const char *words)
{
    const size_t bytes = m->scene->bytes;
    void *before = malloc(2 * bytes), *after = (char *)before + bytes;
    sfem_error err;
    sfemi_saved_seal(m->block);
    sfem_body_save_state(m->body, before);
    assert_status(sfem_body_load_state(m->body, m->block, bytes, &err), SFEM_FORMAT);
    assert_names(err, words);
    sfem_body_save_state(m->body, after);
    assert_memory_equal(before, after, bytes);
    free(before);
    memcpy(m->block, m->scene->block[2], bytes);
}

static void a_body_block_with_a_number_out_of_its_range_is_refused(void **state)
{
    body_block m = make_body_block(4);
    const sfemi_state *v = &m.view;
    unsigned char *mark;
    (void)state;
    v->region_weight[1] = NAN;
    refuse_body(&m, "a weight of a handle");
    v->region_node[3] = 12;
    refuse_body(&m, "a node of a handle");
    v->handle[1].first = 0; /* overlaps the first: released one after the other, a negative size would move */
    refuse_body(&m, "a handle");
    v->handle[1].count = 3; /* one place belongs to nobody */
    v->handle[1].first = 2;
    refuse_body(&m, "a handle");
    v->handle[1].count = INT32_MAX;
    refuse_body(&m, "a handle");
    v->handle[1].count = 0;
    refuse_body(&m, "a handle");
    v->handle[0].path.age = -1;
    refuse_body(&m, "a handle");
    v->handle[0].used = 2147483647; /* they are counted by adding these up */
    refuse_body(&m, "a handle");
    v->pin[1].past[0] = NAN;
    refuse_body(&m, "a pin");
    v->force[2][35] = INFINITY;
    refuse_body(&m, "a load");
    v->head->p = NAN;
    refuse_body(&m, "its head");
    v->head->load_age = 3;
    refuse_body(&m, "its head");
    v->head->sleep = SFEMI_ASLEEP; /* of a body that has no memory to watch for sleep */
    refuse_body(&m, "its head");
    v->head->steps = INT64_MAX;
    refuse_body(&m, "its head");
    v->head->pairs = -1;
    refuse_body(&m, "its head");
    v->head->estimate = NAN;
    refuse_body(&m, "its head");
    v->head->rate = 2;
    refuse_body(&m, "its head");
    ((sfem_real *)(void *)v->damage)[SFEMI_BROKEN] = 1e300; /* no int */
    refuse_body(&m, "the damage of an edge");
    ((sfem_real *)(void *)v->damage)[SFEMI_ACCOUNTS] = 1.5;
    refuse_body(&m, "the damage of an edge");
    mark = (unsigned char *)((sfem_real *)(void *)v->damage + SFEMI_ACCOUNTS + m.body->bonds->edges);
    mark[0] = 255; /* the next round of waiting would forget it */
    refuse_body(&m, "the damage of an edge");
    drop_body_block(&m);
}

/* --------------------------------------------------------------------------------------------
 * mutations
 * -------------------------------------------------------------------------------------------- */

/* Changes, takes out or doubles a few bytes of one input, or puts a piece of another in. */
static size_t mutate(test_random *random, unsigned char *data, size_t size, const unsigned char *other, size_t other_size)
{
    int times = 1 + random_below(random, 4);
    while (times--) {
        const size_t at = (size_t)random_below(random, (sfem_int)size);
        const size_t left = size - at, few = 1 + (size_t)random_below(random, 8), n = few < left ? few : left;
        switch (random_below(random, 6)) {
        case 0: data[at] = (unsigned char)random_bits(random); break;
        case 1: data[at] = (unsigned char)(data[at] ^ 1 << random_below(random, 8)); break;
        case 2: data[at] = (unsigned char)("0-9.e \n#"[random_below(random, 8)]); break;
        case 3:
            if (n == size) break;
            memmove(data + at, data + at + n, left - n);
            size -= n;
            break;
        case 4:
            if (size + n > FUZZ_LARGEST) break;
            memmove(data + at + n, data + at, left);
            size += n;
            break;
        default: memcpy(data + at, other + (size_t)random_below(random, (sfem_int)other_size), 1);
        }
    }
    return size;
}

/* Such inputs for 1 s, or 20 000 of them: the same ones each time, as many as there is time for. */
static void mutate_target(const fuzz_target *target)
{
    static unsigned char seed[64][FUZZ_LARGEST], data[FUZZ_LARGEST];
    const clock_t begin = clock();
    test_random random = {20};
    size_t size[64];
    sfem_int seeds = 0, k, other, run;
    while (seeds < 64 && (size[seeds] = target->seed(seeds, seed[seeds])) > 0) target->run(seed[seeds], size[seeds]), ++seeds;
    assert_true(seeds > 0);
    for (run = 0; run < 20000 && clock() - begin < CLOCKS_PER_SEC; ++run) {
        k = random_below(&random, seeds);
        other = random_below(&random, seeds);
        memcpy(data, seed[k], size[k]);
        if (target->run == fuzz_run_mesh || target->run == fuzz_run_tetgen || target->run == fuzz_run_link ||
            target->run == fuzz_run_surface) {
            target->run(data, mutate(&random, data, size[k], seed[other], size[other]));
        } else { /* a block, some changes and some calls, all at random */
            const size_t bytes = 2 + (size_t)random_below(&random, 60);
            size_t i;
            for (i = 1; i < bytes; ++i) data[i] = (unsigned char)random_bits(&random);
            data[1] &= random_below(&random, 2) ? 15 : 1;
            target->run(data, bytes);
        }
    }
}

#define MUTATIONS(name, k)                                                                         \
    static void mutated_##name##_are_refused_or_safe(void **state)                                 \
    {                                                                                              \
        (void)state;                                                                               \
        mutate_target(fuzz_targets + (k));                                                         \
    }
MUTATIONS(gmsh_files, 0)
MUTATIONS(vtk_files, 1)
MUTATIONS(medit_files, 2)
MUTATIONS(vega_files, 3)
MUTATIONS(tetgen_files, 4)
MUTATIONS(body_states, 5)
MUTATIONS(modal_states, 6)
MUTATIONS(reduced_models, 7)
MUTATIONS(packets, 8)
MUTATIONS(surfaces, 9)
MUTATIONS(vtu_files, 10)
MUTATIONS(inp_files, 11)

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_modal_block_with_handles_or_forces_out_of_order_is_refused),
        cmocka_unit_test(a_modal_block_with_a_number_that_is_not_finite_is_refused),
        cmocka_unit_test(a_reduced_block_with_a_number_out_of_its_range_is_refused),
        cmocka_unit_test(a_body_block_with_a_number_out_of_its_range_is_refused),
        cmocka_unit_test(mutated_gmsh_files_are_refused_or_safe),
        cmocka_unit_test(mutated_vtk_files_are_refused_or_safe),
        cmocka_unit_test(mutated_medit_files_are_refused_or_safe),
        cmocka_unit_test(mutated_vega_files_are_refused_or_safe),
        cmocka_unit_test(mutated_tetgen_files_are_refused_or_safe),
        cmocka_unit_test(mutated_body_states_are_refused_or_safe),
        cmocka_unit_test(mutated_modal_states_are_refused_or_safe),
        cmocka_unit_test(mutated_reduced_models_are_refused_or_safe),
        cmocka_unit_test(mutated_packets_are_refused_or_safe),
        cmocka_unit_test(mutated_surfaces_are_refused_or_safe),
        cmocka_unit_test(mutated_vtu_files_are_refused_or_safe),
        cmocka_unit_test(mutated_inp_files_are_refused_or_safe),
    };
    return run_all_tests(tests);
}
