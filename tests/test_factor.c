/* The factors that bodies of a model share: looked up in its list, by threads at the same time. */
#define SFEM_STATIC
#define SFEM_MINIMAL
#define SFEM_ENABLE_DAMAGE
#define SFEM_ENABLE_NEWTON
#define SOFTFEM_IMPLEMENTATION
#include "support.h"

#include <signal.h>
#include <sys/mman.h>
#include "linear.h"

static sfem_model *make_model(void)
{
    const sfem_int cells[3] = {3, 2, 2};
    const sfem_real size[3] = {0.3, 0.2, 0.2};
    sfem_model_def def = linear_model_def();
    sfem_model *model = NULL;
    sfem_mesh mesh;
    sfem_error err;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    def.mesh = &mesh;
    assert_ok(sfem_model_create(&def, &model, &err), err);
    sfem_mesh_free(&mesh);
    return model;
}

/* A body of which the nodes first .. first + 3 are pinned, prepared for steps of h. */
static sfem_body *make_body(sfem_model *model, sfem_int first, double h)
{
    sfem_body_def def = sfem_default_body_def();
    sfem_int pins[4], k;
    sfem_body *body = NULL;
    sfem_error err;
    for (k = 0; k < 4; ++k) pins[k] = first + k;
    def.pins = pins;
    def.pin_count = 4;
    assert_ok(sfem_body_create(model, &def, &body, &err), err);
    assert_ok(sfem_body_prepare(body, h, &err), err);
    return body;
}

/* --------------------------------------------------------------------------------------------
 * what is compared under the lock
 * -------------------------------------------------------------------------------------------- */

/* A page that holds the mask of a factor, and that nobody may read: whoever does is asked for the lock. */
static struct {
    void *page;
    size_t bytes;
    int *lock;
    volatile int reads, locked;
} watch;

static void note_read(int number)
{
    (void)number;
    ++watch.reads;
    watch.locked += *watch.lock;
    if (mprotect(watch.page, watch.bytes, PROT_READ | PROT_WRITE)) _exit(3);
}

static void masks_are_not_compared_while_the_list_is_locked(void **state)
{
    sfem_model *model = make_model();
    sfem_body *one = make_body(model, 0, 0.01), *same, *other;
    unsigned char *own = one->factor->mask;
    struct sigaction act, before[2];
    int like;
    (void)state;
    watch.bytes = (size_t)sysconf(_SC_PAGESIZE);
    watch.lock = &model->lock;
    assert_int_equal(posix_memalign(&watch.page, watch.bytes, watch.bytes), 0);
    memcpy(watch.page, own, (size_t)model->mesh.nodes);
    one->factor->mask = (unsigned char *)watch.page;
    memset(&act, 0, sizeof act);
    act.sa_handler = note_read;
    assert_int_equal(sigaction(SIGSEGV, &act, &before[0]), 0);
    assert_int_equal(sigaction(SIGBUS, &act, &before[1]), 0);
    for (like = 0; like < 2; ++like) { /* the same factor; one whose analysis serves */
        watch.reads = watch.locked = 0;
        assert_int_equal(mprotect(watch.page, watch.bytes, PROT_NONE), 0);
        same = make_body(model, 0, like ? 0.02 : 0.01);
        assert_int_equal(watch.reads, 1);
        assert_int_equal(watch.locked, 0);
        assert_int_equal(same->factor == one->factor, !like);
        sfem_body_free(same);
    }
    other = make_body(model, 4, 0.01); /* other pins, another hash: the mask is not looked at */
    assert_true(other->factor != one->factor);
    sigaction(SIGSEGV, &before[0], NULL);
    sigaction(SIGBUS, &before[1], NULL);
    one->factor->mask = own;
    free(watch.page);
    sfem_body_free(one);
    sfem_body_free(other);
    sfem_model_free(model);
}

/* Two masks of one hash: made so by hand. */
static void bodies_with_other_pins_and_the_same_hash_share_nothing(void **state)
{
    sfem_model *model = make_model();
    sfem_body *one = make_body(model, 0, 0.01), *other;
    (void)state;
    other = make_body(model, 4, 0.01);
    one->factor->hash = other->factor->hash;
    sfem_body_free(other);
    other = make_body(model, 4, 0.01);
    assert_true(other->factor != one->factor);
    assert_int_equal(one->factor->references, 1);
    assert_int_equal(other->factor->references, 1);
    assert_int_equal(other->factor->mask[0], 0);
    sfem_body_free(one);
    sfem_body_free(other);
    sfem_model_free(model);
}

/* --------------------------------------------------------------------------------------------
 * threads
 * -------------------------------------------------------------------------------------------- */

typedef struct crew {
    sfem_model *model;
    uint64_t hash[3];
    volatile int wrong;
} crew;

static uint64_t step_body(sfem_model *model, sfem_int pins, sfem_status *status)
{
    const sfem_real f[3] = {1, 2, 3};
    sfem_body_def def = sfem_default_body_def();
    sfem_int list[4], k;
    sfem_body *body = NULL;
    uint64_t hash = 0;
    for (k = 0; k < 4; ++k) list[k] = 4 * pins + k;
    def.pins = list;
    def.pin_count = 4;
    *status = sfem_body_create(model, &def, &body, NULL);
    if (*status != SFEM_OK) return 0;
    *status = sfem_body_add_lasting_force(body, 20, f, NULL);
    for (k = 0; k < 3 && *status == SFEM_OK; ++k) *status = sfem_body_step(body, k < 2 ? 0.01 : 0.02, NULL);
    hash = hash_reals(sfem_body_displacement(body), 3 * (size_t)model->mesh.nodes);
    sfem_body_free(body);
    return hash;
}

static void crew_task(void *data, sfem_int index)
{
    crew *c = (crew *)data;
    sfem_status status;
    if (step_body(c->model, index % 3, &status) != c->hash[index % 3] || status != SFEM_OK)
        __atomic_store_n(&c->wrong, 1, __ATOMIC_RELAXED);
}

static void bodies_of_one_model_come_and_go_in_many_threads(void **state)
{
    crew c;
    sfem_status status;
    int k;
    (void)state;
    c.model = make_model();
    c.wrong = 0;
    for (k = 0; k < 3; ++k) {
        c.hash[k] = step_body(c.model, k, &status);
        assert_int_equal(status, SFEM_OK);
    }
    test_parallel_for(120, crew_task, &c, (void *)(intptr_t)6);
    assert_int_equal(c.wrong, 0);
    assert_null(c.model->factors); /* the last of each took its factor away */
    sfem_model_free(c.model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(masks_are_not_compared_while_the_list_is_locked),
        cmocka_unit_test(bodies_with_other_pins_and_the_same_hash_share_nothing),
        cmocka_unit_test(bodies_of_one_model_come_and_go_in_many_threads),
    };
    return run_all_tests(tests);
}
