/* A grabbed node of a body that breaks is not torn off by the hand that holds it. */
#include "support.h"

enum { MAX_NODES = 1100 };

typedef struct soft {
    sfem_mesh mesh;
    sfem_model *model;
    sfem_body *body;
    sfem_int node, tet; /* in the middle of the free end; a tet there */
} soft;

/* A bar 1 x 0.3 x 0.3 m, clamped at x = 0 or free. */
static soft make_soft(int n, double young, int clamped, int protect, sfem_damage_criterion criterion)
{
    const sfem_int cells[3] = {(sfem_int)lround(n / 0.3), n, n};
    static const sfem_real size[3] = {1, 0.3, 0.3};
    sfem_model_def model_def = sfem_default_model_def();
    sfem_damage_def damage = sfem_default_damage_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_int pins[MAX_NODES], i;
    double best = 1e9;
    sfem_error err;
    soft s;
    memset(&s, 0, sizeof s);
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &s.mesh, &err), err);
    assert_true(s.mesh.nodes <= MAX_NODES);
    model_def.mesh = &s.mesh;
    model_def.material.young = young;
    model_def.material.stiffness_damping = 0.01;
    assert_ok(sfem_model_create(&model_def, &s.model, &err), err);
    for (i = 0; i < s.mesh.nodes; ++i) {
        const double *x = s.mesh.x + 3 * i, d = fabs(x[0] - 1) + fabs(x[1] - 0.15) + fabs(x[2] - 0.15);
        if (clamped && x[0] < 1e-9) pins[def.pin_count++] = i;
        if (d < best) best = d, s.node = i;
    }
    for (i = 0; i < 4 * s.mesh.tets; ++i)
        if (s.mesh.tet[i] == s.node) s.tet = i / 4;
    if (protect >= 0) damage.protect_handles = protect; /* else as it comes */
    damage.criterion = criterion;
    if (criterion == SFEM_BREAK_DUCTILE) damage.soften[0] = 0.1, damage.soften[1] = 0.3;
    def.pins = pins;
    def.damage = &damage;
    assert_ok(sfem_body_create(s.model, &def, &s.body, &err), err);
    return s;
}

static void drop(soft *s)
{
    sfem_body_free(s->body);
    sfem_model_free(s->model);
    sfem_mesh_free(&s->mesh);
}

/* Moves a handle by `way` along x within so many steps of 1/60 s. */
static void pull(soft *s, sfem_int handle, double way, int steps)
{
    double from[3], to[3];
    sfem_error err;
    int i;
    sfem_body_handle_position(s->body, handle, from);
    memcpy(to, from, sizeof to);
    for (i = 1; i <= steps; ++i) {
        to[0] = from[0] + way * i / steps;
        assert_ok(sfem_body_move_handle(s->body, handle, to, &err), err);
        assert_ok(sfem_body_step(s->body, 1.0 / 60, &err), err);
    }
}

/* Nodes of the piece that the node belongs to. */
static int piece_size(const soft *s, sfem_int node)
{
    const sfem_int *of = sfem_body_piece_of(s->body);
    int count = 0;
    sfem_int i;
    for (i = 0; i < s->mesh.nodes; ++i) count += of[i] == of[node];
    return count;
}

/* E from 2e4 to 1e6 Pa, Gc 100 J/m^2: unprotected, the node that is pulled leaves the body. */
static void a_grabbed_node_is_not_torn_off(void **state)
{
    static const double young[] = {2e4, 1e5, 1e6};
    size_t k;
    int point, protect;
    (void)state;
    for (k = 0; k < (TEST_SANITIZED ? 1 : TEST_COUNT(young)); ++k)
        for (point = 0; point < 2; ++point)
            for (protect = -1; protect < 1; ++protect) {
                soft s = make_soft(5, young[k], 1, protect, SFEM_BREAK_ENERGY);
                const double bary[4] = {0.3, 0.2, 0.1, 0.4};
                sfem_int handle;
                sfem_error err;
                int left;
                if (point) assert_ok(sfem_body_grab_point(s.body, s.tet, bary, &handle, &err), err);
                else assert_ok(sfem_body_grab_node(s.body, s.node, &handle, &err), err);
                pull(&s, handle, 0.2, 60);
                left = piece_size(&s, point ? s.mesh.tet[4 * s.tet] : s.node);
                print_message("    E %g, %s, %s: %d of %d nodes stay together, %d edges broke\n", young[k], point ? "point" : "node",
                              protect ? "protected" : "not", left, (int)s.mesh.nodes, (int)sfem_body_fracture(s.body).broken);
                if (protect) assert_true(left > 4);
                else assert_int_equal(left, 1);
                drop(&s);
            }
}

/* A free body follows the hand, in one piece. */
static void a_free_body_follows_the_hand(void **state)
{
    int protect;
    (void)state;
    for (protect = -1; protect < 1; ++protect) {
        soft s = make_soft(6, 2e4, 0, protect, SFEM_BREAK_ENERGY);
        sfem_int handle;
        sfem_error err;
        assert_ok(sfem_body_grab_node(s.body, s.node, &handle, &err), err);
        pull(&s, handle, 0.25, 60);
        assert_int_equal(sfem_body_fracture(s.body).pieces, protect ? 1 : 2);
        drop(&s);
    }
}

static void ductile_edges_are_protected_too(void **state)
{
    int protect;
    (void)state;
    for (protect = -1; protect < 1; ++protect) {
        soft s = make_soft(4, 2e4, 1, protect, SFEM_BREAK_DUCTILE);
        sfem_int handle;
        sfem_error err;
        double least = 1;
        int e, k;
        assert_ok(sfem_body_grab_node(s.body, s.node, &handle, &err), err);
        pull(&s, handle, 0.2, 60);
        for (e = 0; e < s.mesh.tets; ++e)
            for (k = 0; k < 4; ++k)
                if (s.mesh.tet[4 * e + k] == s.node && s.mesh.tet[4 * e + (k + 1) % 4] != s.node)
                    least = fmin(least, sfem_body_edge_left(s.body, s.node, s.mesh.tet[4 * e + (k + 1) % 4]));
        if (protect) assert_true(least == 1);
        else assert_true(least < 1);
        drop(&s);
    }
}

/* While it is held: after release they may break again; blades, and who says so, break them at any time; a loaded state
 * knows what is held. */
static void protection_ends_with_the_handle_and_is_not_from_blades(void **state)
{
    soft s = make_soft(5, 2e4, 1, -1, SFEM_BREAK_ENERGY), t = make_soft(5, 2e4, 1, -1, SFEM_BREAK_ENERGY);
    const size_t bytes = sfem_body_state_size(s.body);
    void *memory = malloc(bytes);
    sfem_int handle, other = -1, k;
    sfem_error err;
    (void)state;
    assert_non_null(memory);
    assert_ok(sfem_body_grab_node(s.body, s.node, &handle, &err), err);
    sfem_body_save_state(s.body, memory);
    assert_ok(sfem_body_load_state(t.body, memory, bytes, &err), err);
    pull(&t, handle, 0.2, 60);
    assert_true(piece_size(&t, t.node) > 4);
    sfem_body_release_handle(t.body, handle);
    assert_ok(sfem_body_set_state(t.body, NULL, NULL, &err), err);
    sfem_body_heal(t.body);
    { /* the same node, pulled by a force */
        const double f[3] = {400, 0, 0};
        assert_ok(sfem_body_add_lasting_force(t.body, t.node, f, &err), err);
        for (k = 0; k < 60 && piece_size(&t, t.node) > 1; ++k) assert_ok(sfem_body_step(t.body, 1.0 / 60, &err), err);
        assert_int_equal(piece_size(&t, t.node), 1);
    }
    for (k = 0; k < 4; ++k)
        if (s.mesh.tet[4 * s.tet + k] != s.node) other = s.mesh.tet[4 * s.tet + k];
    assert_ok(sfem_body_break_edge(s.body, s.node, other, &err), err);
    for (k = 0; k < 20; ++k) assert_ok(sfem_body_step(s.body, 1.0 / 60, &err), err);
    assert_true(sfem_body_edge_left(s.body, s.node, other) == 0);
    free(memory);
    drop(&s);
    drop(&t);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_grabbed_node_is_not_torn_off),
        cmocka_unit_test(a_free_body_follows_the_hand),
        cmocka_unit_test(ductile_edges_are_protected_too),
        cmocka_unit_test(protection_ends_with_the_handle_and_is_not_from_blades),
    };
    return run_all_tests(tests);
}
