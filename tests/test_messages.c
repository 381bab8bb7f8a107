/* Messages that name the mistake: numbers from 1, files without tets, missing materials, bodies that can still move, units. */
#include "support.h"
#include "linear.h"

static sfem_mesh make_block(sfem_int cells, double length)
{
    const sfem_int n[3] = {cells, 2, 2};
    const sfem_real size[3] = {length, length / 2, length / 2};
    sfem_mesh mesh;
    sfem_error err;
    assert_ok(sfem_mesh_block(n, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    return mesh;
}

static void numbers_from_one_are_recognised(void **state)
{
    static const char vtk[] = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n"
                              "0 0 0 1 0 0 0 1 0 0 0 1\nCELLS 1 5\n4 %d 1 2 %d\nCELL_TYPES 1\n10\n";
    sfem_mesh mesh = make_block(6, 1), read;
    sfem_int i;
    sfem_error err;
    char text[400];
    (void)state;
    for (i = 0; i < 4 * mesh.tets; ++i) ++mesh.tet[i];
    assert_status(sfem_mesh_check(&mesh, NULL, &err), SFEM_BAD_MESH);
    assert_names(err, "names node 63, the mesh has 63: numbered from 1?");
    mesh.tet[17] = 0; /* then they are not */
    assert_status(sfem_mesh_check(&mesh, NULL, &err), SFEM_BAD_MESH);
    assert_null(strstr(err.text, "from 1"));
    sfem_mesh_free(&mesh);
    snprintf(text, sizeof text, vtk, 3, 4);
    assert_status(sfem_mesh_parse(text, strlen(text), NULL, &read, &err), SFEM_BAD_MESH);
    assert_names(err, "tet 0 names node 4, the mesh has 4: numbered from 1?");
    snprintf(text, sizeof text, vtk, 3, 5);
    assert_status(sfem_mesh_parse(text, strlen(text), NULL, &read, &err), SFEM_BAD_MESH);
    assert_null(strstr(err.text, "from 1"));
    {
        sfem_mesher_def def = sfem_default_mesher_def();
        double x[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
        sfem_int tri[12] = {1, 3, 2, 1, 2, 4, 2, 3, 4, 3, 1, 4};
        sfem_surface s;
        memset(&s, 0, sizeof s);
        s.nodes = s.triangles = 4;
        s.x = x;
        s.tri = tri;
        assert_status(sfem_mesh_from_surface(&def, &s, &read, NULL, &err), SFEM_BAD_MESH);
        assert_names(err, "names vertex 4, not in 0 .. 3: numbered from 1?");
        tri[0] = 0;
        assert_status(sfem_mesh_from_surface(&def, &s, &read, NULL, &err), SFEM_BAD_MESH);
        assert_null(strstr(err.text, "from 1"));
    }
}

static void files_without_tets_say_what_they_have(void **state)
{
    static const struct {
        const char *text;
        sfem_status status;
        const char *words;
    } file[] = {
        {"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 4 1 4\n2 1 0 4\n1\n2\n3\n4\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n$EndNodes\n"
         "$Elements\n1 3 1 3\n2 1 2 3\n1 1 2 3\n2 1 2 4\n3 1 3 4\n$EndElements\n",
         SFEM_BAD_MESH, "4 nodes and 3 triangles, but no 4-node tets: sfem_mesh_from_surface"},
        {"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n$EndNodes\n"
         "$Elements\n2\n1 2 2 0 1 1 2 3\n2 2 2 0 1 1 3 2\n$EndElements\n",
         SFEM_BAD_MESH, "3 nodes and 2 triangles, but no 4-node tets: sfem_mesh_from_surface"},
        {"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n10\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 0 0 0\n6 0 0 0\n7 0 0 0\n8 0 0 "
         "0\n9 0 0 0\n10 0 0 0\n$EndNodes\n$Elements\n2\n1 2 2 0 1 1 2 3\n2 11 2 0 1 1 2 3 4 5 6 7 8 9 10\n$EndElements\n",
         SFEM_BAD_MESH, "there are 1 tets of 10 nodes: the option 'linear'"},
        {"# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 3 double\n0 0 0 1 0 0 0 1 0\n"
         "CELLS 2 8\n3 0 1 2\n3 0 2 1\nCELL_TYPES 2\n5 5\n",
         SFEM_BAD_MESH, "3 nodes and 2 triangles, but no 4-node tets: sfem_mesh_from_surface"},
        {"MeshVersionFormatted 1\nDimension 3\nVertices 3\n0 0 0 0\n1 0 0 0\n0 1 0 0\nTriangles 2\n1 2 3 0\n1 3 2 0\nEnd\n",
         SFEM_FORMAT, "there are no Tetrahedra, but 2 triangles: sfem_mesh_from_surface"},
        {"MeshVersionFormatted 1\nDimension 3\nVertices 3\n0 0 0 0\n1 0 0 0\n0 1 0 0\nTriangles 1\n1 2 3 0\nTetrahedra 0\nEnd\n",
         SFEM_BAD_MESH, "3 nodes and 1 triangles, but no 4-node tets"},
        {"MeshVersionFormatted 1\nDimension 3\nVertices 1\n0 0 0 0\nEnd\n", SFEM_FORMAT, "there are no Tetrahedra"},
    };
    sfem_mesh mesh;
    sfem_error err;
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(file); ++k) {
        assert_status(sfem_mesh_parse(file[k].text, strlen(file[k].text), NULL, &mesh, &err), file[k].status);
        assert_names(err, file[k].words);
    }
}

static void a_missing_material_tells_where_numbers_start(void **state)
{
    sfem_mesh mesh = make_block(2, 1);
    sfem_model_def def = sfem_default_model_def();
    sfem_material two[2];
    sfem_int *number = (sfem_int *)calloc((size_t)mesh.tets, sizeof *number), i;
    sfem_model *model = NULL;
    sfem_error err;
    (void)state;
    assert_non_null(number);
    two[0] = two[1] = sfem_default_material();
    for (i = 0; i < mesh.tets; ++i) number[i] = 1 + i % 2;
    def.mesh = &mesh;
    def.materials = two;
    def.material_count = 2;
    def.tet_material = number;
    assert_status(sfem_model_create(&def, &model, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "tet 1 has material 2, there are 0 to 1: tet_material numbers start at 0, those of this mesh at 1");
    assert_int_equal(err.tet, 1);
    number[4] = 0;
    assert_status(sfem_model_create(&def, &model, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "tet 1 has material 2, which is missing: there are 2, and the tet_material numbers of this mesh are 0 to 2");
    def.tet_material = NULL;
    mesh.region = number;
    assert_status(sfem_model_create(&def, &model, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "the region numbers of this mesh are 0 to 2");
    mesh.region = NULL;
    free(number);
    sfem_mesh_free(&mesh);
}

/* pins with axes, ended by -1; the words, or NULL: it has a solution */
typedef struct held_case {
    sfem_int pin[5];
    unsigned char axes[4];
    const char *words;
} held_case;

/* Nodes of the block are (3 i + j) 3 + k: 0 and 2 on one line along z, 0 and 6 along y, 0 and 18 along x. */
static void a_body_that_can_still_move_names_the_motion(void **state)
{
    static const held_case held[] = {
        {{-1}, {0}, "no pin or handle holds the body"},
        {{3, -1}, {7}, "the pins let the body rotate about node 3"},
        {{0, 18, -1}, {7, 7}, "the pins let the body rotate about the axis through nodes 0 and 18"},
        {{0, 18, -1}, {7, 6}, "the pins let the body rotate about the axis through node 0 along ("},
        {{0, 18, -1}, {7, 1}, "pins and handles leave the body 3 rigid motions"},
        {{0, 2, 6, 18}, {3, 3, 3, 3}, "the pins let the body move along ("},
        {{0, 18, 6, -1}, {7, 7, 7}, NULL},
        {{0, 18, 6, -1}, {7, 6, 4}, NULL},
    };
    sfem_mesh mesh = make_block(2, 1);
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(held); ++k) {
        sfem_model_def model_def = linear_model_def();
        sfem_body_def def = sfem_default_body_def();
        sfem_model *model = NULL;
        sfem_body *body = NULL;
        sfem_error err;
        model_def.mesh = &mesh;
        assert_ok(sfem_model_create(&model_def, &model, &err), err);
        while (def.pin_count < 4 && held[k].pin[def.pin_count] >= 0) ++def.pin_count;
        def.pins = held[k].pin;
        def.pin_axes = held[k].axes;
        def.gravity[1] = -9.81;
        assert_ok(sfem_body_create(model, &def, &body, &err), err);
        if (held[k].words) {
            assert_status(sfem_body_solve_static(body, &err), SFEM_NOT_SPD);
            assert_names(err, held[k].words);
            assert_status(sfem_body_solve_static(body, NULL), SFEM_NOT_SPD);
        } else {
            assert_ok(sfem_body_solve_static(body, &err), err);
        }
        sfem_body_free(body);
        sfem_model_free(model);
    }
    sfem_mesh_free(&mesh);
}

/* Two blocks side by side: the one that fails is spoken of. A handle holds as a pin does. */
static void parts_and_handles_count(void **state)
{
    sfem_mesh one = make_block(2, 1), two;
    sfem_model_def model_def = linear_model_def();
    sfem_body_def def = exact_body_def();
    const sfem_int pins[3] = {0, 6, 18};
    sfem_model *model = NULL;
    sfem_body *body = NULL;
    sfem_int handle, i;
    sfem_error err;
    (void)state;
    memset(&two, 0, sizeof two);
    two.nodes = 2 * one.nodes;
    two.tets = 2 * one.tets;
    two.x = (sfem_real *)calloc(6 * (size_t)one.nodes, sizeof *two.x);
    two.tet = (sfem_int *)calloc(8 * (size_t)one.tets, sizeof *two.tet);
    assert_true(two.x && two.tet);
    for (i = 0; i < 6 * one.nodes; ++i) two.x[i] = one.x[i % (3 * one.nodes)] + (i >= 3 * one.nodes ? 5 : 0);
    for (i = 0; i < 8 * one.tets; ++i) two.tet[i] = one.tet[i % (4 * one.tets)] + (i >= 4 * one.tets ? one.nodes : 0);
    model_def.mesh = &two;
    assert_ok(sfem_model_create(&model_def, &model, &err), err);
    def.pins = pins;
    def.pin_count = 3;
    assert_ok(sfem_body_create(model, &def, &body, &err), err);
    assert_status(sfem_body_solve_static(body, &err), SFEM_NOT_SPD);
    assert_names(err, "no pin or handle holds this part of the body");
    assert_ok(sfem_body_grab_node(body, one.nodes, &handle, &err), err);
    assert_status(sfem_body_solve_static(body, &err), SFEM_NOT_SPD);
    assert_names(err, "the pins let the body rotate about node 27");
    assert_ok(sfem_body_grab_node(body, one.nodes + 6, &handle, &err), err);
    assert_status(sfem_body_solve_static(body, &err), SFEM_NOT_SPD);
    assert_names(err, "the axis through nodes 27 and 33");
    assert_ok(sfem_body_grab_node(body, one.nodes + 18, &handle, &err), err);
    assert_ok(sfem_body_solve_static(body, &err), err);
    sfem_body_free(body);
    sfem_model_free(model);
    free(two.x);
    free(two.tet);
    sfem_mesh_free(&one);
}

static void units_that_look_wrong_are_named(void **state)
{
    static const struct {
        double length, young, density, poisson, h;
        int count;
        const char *words;
    } body[] = {
        {1, 1e6, 1000, 0.3, 1.0 / 60, 0, ""},
        {1, 1e6, 1000, 0.3, 0, 0, ""},
        {0.05, 1e4, 1000, 0.3, 0.02, 0, ""},
        {50, 2e11, 7800, 0.3, 0.02, 0, ""},
        {200, 1, 1000, 0.3, 16, 4, "the body is 200 m across"},
        {200, 1, 1000, 0.3, 16, 4, "a modulus is 1 Pa"},
        {200, 1, 1000, 0.3, 16, 4, "sinks into itself"},
        {200, 1, 1000, 0.3, 16, 4, "the step is 16 s: in ms?"},
        {1, 1e6, 1, 0.3, 0.02, 1, "a density is 1 kg/m^3, water has 1000: in g/cm^3?"},
        {1, 1e6, 1000, 0.495, 0.02, 1, "a Poisson ratio is 0.495"},
        {1e-4, 1e6, 1000, 0.3, 0.02, 1, "the body is 0.0001 m across"},
        {1, 1e13, 1e5, 0.3, 0.02, 2, "steel has 2e11"},
    };
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(body); ++k) {
        sfem_mesh mesh = make_block(2, body[k].length);
        sfem_model_def def = sfem_default_model_def();
        sfem_model *model = NULL;
        sfem_error err;
        char text[600], small[40];
        int lines = 0;
        const char *p;
        def.mesh = &mesh;
        def.material.young = body[k].young;
        def.material.density = body[k].density;
        def.material.poisson = body[k].poisson;
        assert_ok(sfem_model_create(&def, &model, &err), err);
        assert_int_equal(sfem_model_advice(model, body[k].h, text, sizeof text), body[k].count);
        if (!strstr(text, body[k].words)) fail_msg("\"%s\" does not say \"%s\"", text, body[k].words);
        for (p = text; *p; ++p) lines += *p == '\n';
        assert_int_equal(lines + (text[0] != 0), body[k].count);
        assert_int_equal(sfem_model_advice(model, body[k].h, NULL, 0), body[k].count);
        memset(small, 77, sizeof small);
        assert_int_equal(sfem_model_advice(model, body[k].h, small, 30), body[k].count);
        assert_true(strlen(small) < 30);
        for (lines = 30; lines < 40; ++lines) assert_int_equal(small[lines], 77);
        sfem_model_free(model);
        sfem_mesh_free(&mesh);
    }
}

static sfem_real below(const sfem_real x[3], void *user)
{
    (void)user;
    return x[2] - 0.5;
}

/* A definition that is all zero, or another kind's, is told from one with odd values. */
static void definitions_say_who_has_to_make_them(void **state)
{
    const sfem_int cells[3] = {1, 1, 1};
    const sfem_real size[3] = {1, 1, 1}, box[2][3] = {{0, 0, 0}, {1, 1, 1}};
    sfem_model_def model_def = sfem_default_model_def(), no_model_def;
    sfem_body_def body_def, damaged = sfem_default_body_def();
    sfem_damage_def damage;
    sfem_contact_def contact_def;
    sfem_obstacle_def obstacle_def;
    sfem_contact *contact;
    sfem_modes_def modes_def;
    sfem_mesher_def mesher_def;
    sfem_link_def link_def;
    sfem_ldl_def ldl_def;
    sfem_mesh mesh, other;
    sfem_model *model;
    sfem_body *body;
    sfem_modes modes;
    sfem_sender *sender;
    sfem_ldl *ldl;
    sfem_error err;
    (void)state;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    model_def.mesh = &mesh;
    assert_ok(sfem_model_create(&model_def, &model, &err), err);
#define SAYS(call, name)                                                                                               \
    do {                                                                                                               \
        assert_int_equal(call, SFEM_BAD_ARGUMENT);                                                                     \
        assert_non_null(strstr(err.text, name));                                                                       \
    } while (0)
    memset(&no_model_def, 0, sizeof no_model_def);
    no_model_def.mesh = &mesh;
    SAYS(sfem_model_create(&no_model_def, &model, &err), "sfem_default_model_def");
    memset(&body_def, 0, sizeof body_def);
    SAYS(sfem_body_create(model, &body_def, &body, &err), "sfem_default_body_def");
    body_def.cookie = model_def.cookie;
    SAYS(sfem_body_create(model, &body_def, &body, &err), "sfem_default_body_def");
    memset(&damage, 0, sizeof damage);
    damaged.damage = &damage;
    SAYS(sfem_body_create(model, &damaged, &body, &err), "sfem_default_damage_def");
    memset(&contact_def, 0, sizeof contact_def);
    SAYS(sfem_contact_create(&contact_def, &contact, &err), "sfem_default_contact_def");
    assert_ok(sfem_contact_create(NULL, &contact, &err), err);
    memset(&obstacle_def, 0, sizeof obstacle_def);
    SAYS(sfem_contact_add_obstacle(contact, &obstacle_def, NULL, &err), "sfem_default_obstacle_def");
    obstacle_def = sfem_default_obstacle_def();
    memset(&obstacle_def.contact, 0, sizeof obstacle_def.contact);
    SAYS(sfem_contact_add_obstacle(contact, &obstacle_def, NULL, &err), "sfem_default_contact_surface");
    sfem_contact_free(contact);
    memset(&modes_def, 0, sizeof modes_def);
    SAYS(sfem_modes_create(model, &modes_def, &modes, &err), "sfem_default_modes_def");
    memset(&mesher_def, 0, sizeof mesher_def);
    SAYS(sfem_mesh_from_sdf(&mesher_def, below, NULL, box, &other, NULL, &err), "sfem_default_mesher_def");
    memset(&link_def, 0, sizeof link_def);
    SAYS(sfem_sender_create(&link_def, &sender, &err), "sfem_default_link_def");
    memset(&ldl_def, 0, sizeof ldl_def);
    SAYS(sfem_ldl_create(&ldl_def, sfem_model_stiffness(model), &ldl, &err), "sfem_default_ldl_def");
#undef SAYS
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
}

/* What is data gets a sentence, and changes nothing. */
static void handles_and_meshes_that_are_not_there_are_named(void **state)
{
    static const sfem_int wrong[] = {-1, 1, 15, 16, 1000};
    const sfem_real to[3] = {1, 2, 3};
    sfem_mesh mesh = make_block(2, 1);
    sfem_model_def model_def = sfem_default_model_def();
    sfem_body_def def = sfem_default_body_def();
    sfem_model *model;
    sfem_body *body;
    sfem_int handle;
    sfem_error err;
    size_t k, size;
    char *before, *after;
    (void)state;
    assert_status(sfem_model_create(&model_def, &model, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "set mesh");
    model_def.mesh = &mesh;
    assert_ok(sfem_model_create(&model_def, &model, &err), err);
    assert_ok(sfem_body_create(model, &def, &body, &err), err);
    assert_ok(sfem_body_grab_node(body, 0, &handle, &err), err);
    assert_int_equal(handle, 0);
    size = sfem_body_state_size(body);
    before = (char *)malloc(size), after = (char *)malloc(size);
    assert_true(before && after);
    sfem_body_save_state(body, before);
    for (k = 0; k < TEST_COUNT(wrong); ++k) {
        char text[40];
        assert_status(sfem_body_move_handle(body, wrong[k], to, &err), SFEM_BAD_ARGUMENT);
        snprintf(text, sizeof text, "there is no handle %d", (int)wrong[k]);
        assert_names(err, text);
    }
    sfem_body_save_state(body, after);
    assert_memory_equal(before, after, size);
    free(before);
    free(after);
    sfem_body_free(body);
    sfem_model_free(model);
    sfem_mesh_free(&mesh);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(handles_and_meshes_that_are_not_there_are_named),
        cmocka_unit_test(definitions_say_who_has_to_make_them),
        cmocka_unit_test(numbers_from_one_are_recognised),
        cmocka_unit_test(files_without_tets_say_what_they_have),
        cmocka_unit_test(a_missing_material_tells_where_numbers_start),
        cmocka_unit_test(a_body_that_can_still_move_names_the_motion),
        cmocka_unit_test(parts_and_handles_count),
        cmocka_unit_test(units_that_look_wrong_are_named),
    };
    return run_all_tests(tests);
}
