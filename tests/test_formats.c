/* Mesh files: .vtu, binary VTK and Medit, Abaqus; sets, regions, materials by name; 10-node tets; welding; what is hostile. */
#include "support.h"

#include "mesh_files.h"

/* Those of mesh_files.h that hold no text only, and those that name their sets. */
enum { VTU = 0, VTU_BASE64 = 1, VTU_RAW = 2, VTU_APPENDED = 3, VTK_OLD = 5, VTK_NEW = 6, MESHB = 7, INP = 11, PART = 12,
       GMSH4 = 13, GMSH2 = 14, VEGA = 16 };

typedef struct parsed {
    sfem_mesh m;
    sfem_mesh_sets s;
    sfem_mesh_read_info info;
} parsed;

static parsed parse(const void *data, size_t bytes, const sfem_mesh_read_def *def)
{
    parsed p;
    sfem_error err;
    assert_ok(sfem_mesh_parse_sets(data, bytes, def, &p.m, &p.s, &p.info, &err), err);
    return p;
}

static parsed parse_text(const char *text, const sfem_mesh_read_def *def) { return parse(text, strlen(text), def); }

static void drop(parsed *p)
{
    sfem_mesh_sets_free(&p->s);
    sfem_mesh_free(&p->m);
}

static void assert_sample(const sfem_mesh *m)
{
    int i;
    assert_int_equal(m->nodes, 5);
    assert_int_equal(m->tets, 2);
    for (i = 0; i < 15; ++i) assert_true(m->x[i] == mesh_file_x[i]);
    for (i = 0; i < 8; ++i) assert_int_equal(m->tet[i], mesh_file_tets[i]);
}

/* The set has these members, given as "0 1 4". */
static void assert_set(const parsed *p, const char *name, int of_tets, const char *members)
{
    const sfem_set *s = sfem_mesh_sets_find(&p->s, name, of_tets);
    char text[200] = "";
    sfem_int i;
    if (!s) fail_msg("there is no set '%s'", name);
    for (i = 0; i < s->count; ++i) sprintf(text + strlen(text), "%s%d", i ? " " : "", (int)s->member[i]);
    if (strcmp(text, members) != 0) fail_msg("set '%s' is %s, not %s", name, text, members);
}

/* Refused with this status and these words, whatever was there is as it was, and no memory is lost. */
static void refuse(const void *data, size_t bytes, const sfem_mesh_read_def *given, sfem_status wanted, const char *words)
{
    sfem_mesh_read_def def = given ? *given : sfem_default_mesh_read_def();
    test_memory memory = {0};
    sfem_error err = {SFEM_OK, -1, -1, -1, ""};
    sfem_mesh m, before;
    sfem_mesh_sets s;
    sfem_mesh_read_info info;
    sfem_status status;
    unsigned char *copy = (unsigned char *)malloc(bytes + 1); /* it ends where the sanitizer looks */
    memcpy(copy + 1, data, bytes);
    memset(&m, 0x5a, sizeof m);
    before = m;
    def.allocator = test_allocator(&memory);
    status = sfem_mesh_parse_sets(copy + 1, bytes, &def, &m, &s, &info, &err);
    if (status != wanted || !strstr(err.text, words))
        fail_msg("status %d, \"%s\"; wanted %d, \"%s\"", status, err.text, wanted, words);
    assert_memory_equal(&m, &before, sizeof m);
    assert_no_leak(memory);
    assert_true(memory.peak < 200 * bytes + 20000);
    free(copy);
}

/* The text with the first `old` replaced. */
static char *replaced(const char *text, const char *old, const char *by)
{
    const char *at = strstr(text, old);
    char *copy = (char *)malloc(strlen(text) + strlen(by) + 1);
    if (!at) fail_msg("'%s' is not there", old);
    memcpy(copy, text, (size_t)(at - text));
    strcpy(copy + (at - text), by);
    strcat(copy, at + strlen(old));
    return copy;
}

typedef struct fault {
    const char *old, *by;
    sfem_status status;
    const char *words;
} fault;

static void refuse_each(const char *text, const fault *f, size_t count)
{
    size_t i;
    for (i = 0; i < count; ++i) {
        char *copy = replaced(text, f[i].old, f[i].by);
        refuse(copy, strlen(copy), NULL, f[i].status, f[i].words);
        free(copy);
    }
}

/* ---- what is read ---- */

static void the_same_mesh_comes_from_each_file(void **state)
{
    int k;
    (void)state;
    for (k = 0; k < MESH_FILES; ++k) {
        static mesh_file f;
        const char *name = mesh_file_sample(k, &f);
        sfem_mesh m;
        sfem_error err;
        parsed p = parse(f.data, f.n, NULL);
        assert_sample(&p.m);
        if (!p.m.region || p.m.region[0] == p.m.region[1]) fail_msg("%s: no two regions", name);
        if (k < INP || k == GMSH4 || k == GMSH2 || k == GMSH2 + 1) {
            assert_int_equal(p.m.region[0], 4);
            assert_int_equal(p.m.region[1], 5);
            assert_int_equal(p.info.triangles, 1);
            assert_set(&p, k == GMSH4 || k == GMSH2 ? "the top" : "surface 7", 0, "0 1 2");
        }
        assert_int_equal(p.s.regions, 2);
        assert_int_equal(p.s.region[0].tets, 1);
        assert_int_equal(p.s.region[0].number, p.m.region[0]);
        assert_ok(sfem_mesh_parse(f.data, f.n, NULL, &m, &err), err);
        assert_sample(&m);
        assert_memory_equal(m.region, p.m.region, 2 * sizeof *m.region);
        sfem_mesh_free(&m);
        drop(&p);
    }
}

static void names_of_gmsh_and_vega_and_medit_are_those_of_sets_and_regions(void **state)
{
    static mesh_file f;
    parsed p;
    int k;
    (void)state;
    for (k = GMSH4; k <= GMSH2; ++k) {
        mesh_file_sample(k, &f);
        p = parse(f.data, f.n, NULL);
        assert_set(&p, "soft", 1, k == GMSH2 ? "0 1" : "0 1");
        assert_set(&p, "HARD", 1, "1");
        assert_string_equal(p.s.region[0].name, "soft");
        assert_string_equal(p.s.region[1].name, "hard");
        assert_int_equal(sfem_mesh_sets_region(&p.s, "Hard")->number, 5);
        assert_int_equal(sfem_mesh_sets_region(&p.s, "5")->number, 5);
        assert_null(sfem_mesh_sets_region(&p.s, "6"));
        assert_null(sfem_mesh_sets_find(&p.s, "soft", 0));
        assert_null(sfem_mesh_sets_find(&p.s, "sof", 1));
        drop(&p);
    }
    mesh_file_sample(VEGA, &f);
    p = parse(f.data, f.n, NULL);
    assert_set(&p, "hard", 1, "1");
    assert_string_equal(p.s.region[0].name, "rubber");
    assert_true(p.s.region[0].has_elastic && p.s.region[0].has_density);
    assert_true(p.s.region[1].young == 2e11 && p.s.region[1].poisson == 0.3 && p.s.region[1].density == 7800);
    drop(&p);
    mesh_file_sample(MESHB, &f);
    p = parse(f.data, f.n, NULL);
    assert_set(&p, "point 3", 0, "4");
    assert_string_equal(p.s.region[1].name, "5");
    drop(&p);
}

/* Elements of another dimension than their block says, or volumes that are no tets, are in no set of that block. */
static void elements_of_a_wrong_dimension_are_in_no_set(void **state)
{
    static const char head[] = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n2 7 \"top\"\n3 4 \"soft\"\n"
                               "$EndPhysicalNames\n$Entities\n0 0 1 1\n1 0 0 0 1 1 0 1 7 0\n1 0 0 0 1 1 1 1 4 0\n$EndEntities\n"
                               "$Nodes\n1 5 1 5\n3 1 0 5\n1\n2\n3\n4\n5\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 1 1\n$EndNodes\n$Elements\n";
    static const char *const block[3] = {"2 2 1 2\n2 1 4 1\n1 1 2 3 4\n3 1 4 1\n2 2 3 4 5\n", /* a tet in a surface */
                                         "2 2 1 2\n3 1 2 1\n1 3 4 5\n3 1 4 1\n2 1 2 3 4\n",   /* a triangle in a volume */
                                         "2 2 1 2\n3 1 7 1\n1 1 2 3 4 5\n3 1 4 1\n2 1 2 3 4\n"}; /* a pyramid */
    static const char *const soft[3] = {"1", "0", "0"};
    char text[1000];
    int k;
    (void)state;
    for (k = 0; k < 3; ++k) {
        parsed p;
        sprintf(text, "%s%s$EndElements\n", head, block[k]);
        p = parse_text(text, NULL);
        assert_set(&p, "soft", 1, soft[k]);
        assert_set(&p, "top", 0, "");
        assert_int_equal(p.info.others, k == 2);
        drop(&p);
    }
}

static void sets_and_materials_of_abaqus_are_read(void **state)
{
    static mesh_file f;
    parsed p;
    (void)state;
    mesh_file_sample(INP, &f);
    p = parse(f.data, f.n, NULL);
    assert_set(&p, "ALL", 0, "0 1 2 3 4");
    assert_set(&p, "some", 0, "0 2 4");
    assert_set(&p, "odd", 0, "1 3");
    assert_set(&p, "both", 0, "0 1 2 3 4");
    assert_set(&p, "top", 0, "0 1 2"); /* of a shell: its nodes */
    assert_set(&p, "soft", 1, "0");
    assert_set(&p, "all", 1, "0 1");
    assert_string_equal(p.s.region[0].name, "soft");
    assert_string_equal(p.s.region[0].material, "rubber");
    assert_string_equal(p.s.region[1].material, "steel");
    assert_true(p.s.region[0].young == 1e6 && p.s.region[0].poisson == 0.45 && p.s.region[0].density == 950);
    assert_true(p.s.region[1].has_elastic && !p.s.region[1].has_density);
    drop(&p);
    mesh_file_sample(PART, &f);
    p = parse(f.data, f.n, NULL);
    assert_set(&p, "fix", 0, "0 1 2");
    assert_set(&p, "RP", 0, ""); /* a reference point: the assembly has nodes of its own */
    assert_set(&p, "Set 1", 1, "0");
    assert_string_equal(p.s.region[1].name, "two");
    assert_true(p.s.region[1].young == 1e5 && p.s.region[1].density == 1000);
    drop(&p);
    p = parse_text("*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT,TYPE=C3D4\n1,1,2,3,4\n", NULL);
    assert_null(p.m.region);
    assert_int_equal(p.s.regions + p.s.sets, 0);
    drop(&p);
    p = parse_text("*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT,TYPE=C3D4,ELSET=a\n1,1,2,3,4\n", NULL);
    assert_string_equal(p.s.region[0].name, "a"); /* without a section that of its block */
    drop(&p);
}

/* A tet of 10 nodes and one of 4 that shares a face with it; node 5 of the file is in no tet. */
#define POINTS10 "0 0 0\n2 0 0\n0 2 0\n0 0 2\n9 9 9\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n0 1 1\n0 0 -2\n"
static const char *const quadratic[] = {
    "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n12\n1 0 0 0\n2 2 0 0\n3 0 2 0\n4 0 0 2\n5 9 9 9\n6 1 0 0\n7 1 1 0\n8 0 1 0\n"
    "9 0 0 1\n10 1 0 1\n11 0 1 1\n12 0 0 -2\n$EndNodes\n$Elements\n3\n1 9 2 7 1 1 2 3 6 7 8\n"
    "2 11 2 1 1 1 2 3 4 6 7 8 9 11 10\n3 4 2 1 1 1 3 2 12\n$EndElements\n",
    "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 12 float\n" POINTS10
    "CELLS 3 23\n6 0 1 2 5 6 7\n10 0 1 2 3 5 6 7 8 9 10\n4 0 2 1 11\nCELL_TYPES 3\n22 24 10\nCELL_DATA 3\n"
    "SCALARS region int\nLOOKUP_TABLE default\n7 1 1\n",
    "*NODE\n1,0,0,0\n2,2,0,0\n3,0,2,0\n4,0,0,2\n5,9,9,9\n6,1,0,0\n7,1,1,0\n8,0,1,0\n9,0,0,1\n10,1,0,1\n11,0,1,1\n12,0,0,-2\n"
    "*ELEMENT,TYPE=STRI65,ELSET=surface 7\n1,1,2,3,6,7,8\n*ELEMENT,TYPE=C3D10M\n2,1,2,3,4,6,7,8,\n9,10,11\n"
    "*ELEMENT,TYPE=C3D4\n3,1,3,2,12\n"};

static void tets_of_10_nodes_are_linear_on_request(void **state)
{
    sfem_mesh_read_def def = sfem_default_mesh_read_def();
    size_t i;
    (void)state;
    def.linear = 1;
    for (i = 0; i < TEST_COUNT(quadratic); ++i) {
        static const sfem_int tets[8] = {0, 1, 2, 3, 0, 2, 1, 4};
        parsed p = parse_text(quadratic[i], &def);
        assert_int_equal(p.m.nodes, 5);
        assert_int_equal(p.m.tets, 2);
        assert_memory_equal(p.m.tet, tets, sizeof tets);
        assert_true(p.m.x[14] == -2);
        assert_int_equal(p.info.linear, 1);
        assert_int_equal(p.info.removed, 7);
        assert_set(&p, "surface 7", 0, "0 1 2"); /* without the nodes that are gone */
        drop(&p);
        refuse(quadratic[i], strlen(quadratic[i]), NULL, SFEM_BAD_MESH, "there are 1 tets of 10 nodes: the option 'linear'");
    }
}

static void medit_and_tetgen_have_tets_of_10_nodes(void **state)
{
    static const char medit[] = "MeshVersionFormatted 2\nDimension 3\nVertices 10\n0 0 0 0\n2 0 0 0\n0 2 0 0\n0 0 2 0\n1 0 0 0\n"
                                "1 1 0 0\n0 1 0 0\n0 0 1 0\n1 0 1 0\n0 1 1 0\nTetrahedraP2 1\n1 2 3 4 5 6 7 8 9 10 3\nEnd\n";
    static const char node[] = "10 3 0 1\n0 0 0 0 5\n1 2 0 0 0\n2 0 2 0 5\n3 0 0 2 0\n4 1 0 0 5\n5 1 1 0 0\n6 0 1 0 0\n"
                               "7 0 0 1 0\n8 1 0 1 0\n9 0 1 1 0\n";
    sfem_mesh_read_def def = sfem_default_mesh_read_def();
    sfem_error err;
    parsed p;
    (void)state;
    refuse(medit, strlen(medit), NULL, SFEM_BAD_MESH, "1 tets of 10 nodes");
    def.linear = 1;
    p = parse_text(medit, &def);
    assert_int_equal(p.m.nodes, 4);
    assert_int_equal(p.m.region[0], 3);
    drop(&p);
    scratch_write(scratch_path("test_formats.node"), node);
    scratch_write(scratch_path("test_formats.ele"), "1 10 1\n0 0 1 2 3 4 5 6 7 8 9 6\n");
    assert_status(sfem_mesh_read(scratch_path("test_formats.node"), NULL, &p.m, &err), SFEM_FORMAT);
    assert_names(err, "elements of 10 nodes, not 4: 1 of them");
    assert_ok(sfem_mesh_read_sets(scratch_path("test_formats.ele"), &def, &p.m, &p.s, &p.info, &err), err);
    assert_int_equal(p.m.nodes, 4);
    assert_int_equal(p.m.region[0], 6);
    assert_set(&p, "point 5", 0, "0 2");
    assert_int_equal(p.info.removed, 6);
    drop(&p);
    remove(scratch_path("test_formats.node"));
    remove(scratch_path("test_formats.ele"));
}

static void triangles_of_a_mesh_file_are_a_surface(void **state)
{
    static const char vtk[] = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 float\n"
                              "0 0 0 1 0 0 1 1 0 0 1 0\nCELLS 2 9\n4 0 1 2 3\n3 0 1 2\nCELL_TYPES 2\n9 5\n";
    static const sfem_int tri[9] = {0, 1, 2, 0, 2, 3, 0, 1, 2};
    static mesh_file f;
    sfem_surface s;
    sfem_error err;
    int k;
    (void)state;
    for (k = 0; k < MESH_FILES; ++k) {
        const char *name = mesh_file_sample(k, &f);
        const sfem_status status = sfem_surface_parse(f.data, f.n, NULL, &s, &err);
        if (k == PART || k == VEGA) {
            assert_int_equal(status, SFEM_BAD_MESH); /* which have no triangle */
            continue;
        }
        if (status != SFEM_OK) fail_msg("%s: %s", name, err.text);
        assert_int_equal(s.triangles, 1);
        assert_int_equal(s.nodes, 5);
        assert_memory_equal(s.tri, tri, 3 * sizeof *tri);
        sfem_surface_free(&s);
    }
    assert_ok(sfem_surface_parse(vtk, sizeof vtk - 1, NULL, &s, &err), err);
    assert_int_equal(s.triangles, 3);
    assert_memory_equal(s.tri, tri, sizeof tri);
    sfem_surface_free(&s);
    refuse(vtk, sizeof vtk - 1, NULL, SFEM_BAD_MESH, "3 triangles, but no 4-node tets");
}

static void what_is_written_comes_back(void **state)
{
    sfem_mesh m;
    sfem_error err;
    sfem_int t, size;
    (void)state;
    for (size = 1; size < 8; size += 3) {
        const char *path[2];
        sfem_real *value;
        sfem_field field;
        int k;
        assert_ok(sfem_mesh_ball(0.3, size, NULL, &m, &err), err);
        m.region = NULL;
        value = (sfem_real *)calloc((size_t)m.tets, sizeof *value);
        field.name = "region"; /* a field of that name is no region: it is real */
        field.values = value;
        field.components = 1;
        field.per_tet = 1;
        for (k = 0; k < 2; ++k) {
            sfem_int *region = (sfem_int *)malloc((size_t)m.tets * sizeof *region);
            parsed p;
            for (t = 0; t < m.tets; ++t) region[t] = t % 5 - 2;
            m.region = k ? region : NULL;
            path[0] = scratch_path("test_formats.vtu");
            path[1] = scratch_path("test_formats.msh");
            assert_ok(sfem_mesh_write_vtu(path[0], &m, NULL, &field, 1, &err), err);
            assert_ok(sfem_mesh_write_msh(path[1], &m, &err), err);
            for (t = 0; t < 2; ++t) {
                assert_ok(sfem_mesh_read_sets(path[t], NULL, &p.m, &p.s, &p.info, &err), err);
                assert_int_equal(p.m.nodes, m.nodes);
                assert_int_equal(p.m.tets, m.tets);
                assert_memory_equal(p.m.x, m.x, 3 * (size_t)m.nodes * sizeof *m.x);
                assert_memory_equal(p.m.tet, m.tet, 4 * (size_t)m.tets * sizeof *m.tet);
                if (k) assert_memory_equal(p.m.region, region, (size_t)m.tets * sizeof *region);
                if (t == 0) assert_true((p.m.region != NULL) == (k == 1));
                drop(&p);
                remove(path[t]);
            }
            free(region);
        }
        m.region = NULL;
        free(value);
        sfem_mesh_free(&m);
    }
}

/* ---- welding, seams ---- */

/* Two blocks of 5 tets side by side, with nodes of their own: the second is moved on by `gap`. */
static sfem_mesh two_blocks(sfem_real gap)
{
    const sfem_int one[3] = {1, 1, 1};
    const sfem_real size[3] = {1, 1, 1};
    sfem_mesh a, m;
    sfem_error err;
    sfem_int i;
    assert_ok(sfem_mesh_block(one, size, SFEM_CELL_6_TETS, NULL, &a, &err), err);
    memset(&m, 0, sizeof m);
    m.nodes = 2 * a.nodes;
    m.tets = 2 * a.tets;
    m.x = (sfem_real *)malloc(3 * (size_t)m.nodes * sizeof *m.x);
    m.tet = (sfem_int *)malloc(4 * (size_t)m.tets * sizeof *m.tet);
    for (i = 0; i < 3 * m.nodes; ++i) m.x[i] = a.x[i % (3 * a.nodes)] + (i >= 3 * a.nodes && i % 3 == 0 ? 1 + gap : 0);
    for (i = 0; i < 4 * m.tets; ++i) m.tet[i] = a.tet[i % (4 * a.tets)] + (i >= 4 * a.tets ? a.nodes : 0);
    sfem_mesh_free(&a);
    return m;
}

static void free_blocks(sfem_mesh *m)
{
    free(m->x);
    free(m->tet);
}

static void a_seam_is_reported_and_welded(void **state)
{
    sfem_mesh m = two_blocks(0);
    sfem_mesh_report r;
    sfem_int map[16], welded, i;
    sfem_error err;
    (void)state;
    assert_ok(sfem_mesh_check(&m, &r, &err), err);
    assert_int_equal(r.coincident, 4);
    assert_int_equal(r.seam, 4); /* two triangles on either side */
    assert_int_equal(r.components, 2);
    assert_int_equal(r.welded_components, 1);
    assert_ok(sfem_mesh_weld(&m, 0, map, &welded, &err), err);
    assert_int_equal(welded, 4);
    assert_int_equal(m.nodes, 12);
    for (i = 0; i < 8; ++i) assert_int_equal(map[i], i);
    assert_ok(sfem_mesh_check(&m, &r, &err), err);
    assert_int_equal(r.coincident + r.seam + r.overlapping + r.unused, 0);
    assert_true(r.components == 1 && r.welded_components == 1 && r.euler == 2);
    assert_near(r.volume, 2, 1e-15, 0);
    assert_ok(sfem_mesh_weld(&m, 0, NULL, &welded, &err), err);
    assert_int_equal(welded, 0);
    free_blocks(&m);
    m = two_blocks(0.001);
    assert_ok(sfem_mesh_check(&m, &r, &err), err);
    assert_int_equal(r.coincident + r.seam, 0);
    assert_true(r.components == 2 && r.welded_components == 2);
    assert_ok(sfem_mesh_weld(&m, 0, NULL, &welded, &err), err);
    assert_int_equal(welded, 0);
    assert_ok(sfem_mesh_weld(&m, 0.0011, NULL, &welded, &err), err);
    assert_int_equal(welded, 4);
    free_blocks(&m);
}

static void a_weld_that_would_spoil_a_tet_changes_nothing(void **state)
{
    sfem_mesh m = two_blocks(0);
    sfem_real *x = (sfem_real *)malloc(48 * sizeof *x);
    sfem_error err;
    (void)state;
    memcpy(x, m.x, 48 * sizeof *x);
    assert_status(sfem_mesh_weld(&m, 1.2, NULL, NULL, &err), SFEM_BAD_MESH);
    assert_names(err, "take a smaller distance");
    assert_true(err.tet >= 0);
    assert_status(sfem_mesh_weld(&m, -1, NULL, NULL, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_mesh_weld(&m, NAN, NULL, NULL, &err), SFEM_BAD_ARGUMENT);
    assert_status(sfem_mesh_weld(&m, 1e200, NULL, NULL, &err), SFEM_BAD_ARGUMENT);
    assert_int_equal(m.nodes, 16);
    assert_memory_equal(m.x, x, 48 * sizeof *x);
    m.x[5] = INFINITY;
    assert_status(sfem_mesh_weld(&m, 0, NULL, NULL, &err), SFEM_NOT_FINITE);
    assert_int_equal(err.node, 1);
    free(x);
    free_blocks(&m);
}

/* Against all pairs: each node goes to the lowest kept one within the distance. */
static void welding_within_a_distance_agrees_with_all_pairs(void **state)
{
    enum { N = 600 };
    static sfem_real x[3 * N];
    test_random random = {7};
    int round;
    (void)state;
    for (round = 0; round < 6; ++round) {
        const sfem_real d = round % 3 == 0 ? 0 : 0.05 * round, scale = round > 3 ? 1e9 : 1;
        sfem_int map[N], to[N], kept = 0, i, k, welded, none[4];
        sfem_mesh m;
        sfem_error err;
        memset(&m, 0, sizeof m);
        random_fill(&random, x, 3 * N, -1, 1);
        for (i = 0; i < N / 2; ++i) memcpy(x + 3 * random_below(&random, N), x + 3 * random_below(&random, N), 3 * sizeof *x);
        for (i = 0; i < 3 * N; ++i) x[i] *= scale;
        for (i = 0; i < N; ++i) {
            for (k = 0, to[i] = -1; k < i && to[i] < 0; ++k) {
                const sfem_real a = x[3 * i] - x[3 * k], b = x[3 * i + 1] - x[3 * k + 1], c = x[3 * i + 2] - x[3 * k + 2];
                if (to[k] >= 0 && to[k] < N && a * a + b * b + c * c <= d * scale * d * scale) to[i] = to[k] + N;
            }
            if (to[i] < 0) to[i] = kept++;
        }
        m.nodes = N;
        m.x = x;
        m.tet = none;
        assert_ok(sfem_mesh_weld(&m, d * scale, map, &welded, &err), err);
        assert_int_equal(m.nodes, kept);
        assert_int_equal(welded, N - kept);
        for (i = 0; i < N; ++i) assert_int_equal(map[i], to[i] % N);
    }
}

static void a_file_is_welded_on_request_with_its_sets(void **state)
{
    static const char text[] = "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n5,1,0,0\n6,0,1,0\n7,0,0,1.001\n8,1,1,1\n"
                               "*ELEMENT,TYPE=C3D4\n1,1,2,3,4\n2,5,6,7,8\n*NSET,NSET=s\n2,5,7,8\n";
    sfem_mesh_read_def def = sfem_default_mesh_read_def();
    sfem_mesh_report r;
    sfem_error err;
    parsed p;
    (void)state;
    p = parse_text(text, &def);
    assert_int_equal(p.m.nodes, 8);
    drop(&p);
    def.weld = 1;
    p = parse_text(text, &def);
    assert_int_equal(p.info.welded, 2);
    assert_set(&p, "s", 0, "1 4 5");
    drop(&p);
    def.weld_distance = 0.01;
    p = parse_text(text, &def);
    assert_int_equal(p.info.welded, 3);
    assert_set(&p, "s", 0, "1 3 4");
    assert_ok(sfem_mesh_check(&p.m, &r, &err), err);
    assert_int_equal(r.components, 1);
    drop(&p);
    def.weld_distance = 2;
    refuse(text, sizeof text - 1, &def, SFEM_BAD_MESH, "take a smaller distance");
    def.weld_distance = -1;
    refuse(text, sizeof text - 1, &def, SFEM_BAD_ARGUMENT, "the distance of welding is -1");
}

/* ---- what is refused ---- */

static void malformed_vtu_is_refused(void **state)
{
    static const fault faults[] = {
        {"type=\"UnstructuredGrid\"", "type=\"PolyData\"", SFEM_FORMAT, "a VTK file of PolyData: only UnstructuredGrid"},
        {"byte_order=", "compressor=\"vtkZLibDataCompressor\" byte_order=", SFEM_FORMAT, "compressed data is not read: write it raw"},
        {"<Piece N", "<Piece NumberOfPoints=\"0\" NumberOfCells=\"0\"/><Piece N", SFEM_FORMAT, "a second Piece"},
        {"NumberOfPoints=\"5\"", "NumberOfPoints=\"4\"", SFEM_FORMAT, "expected the end of the array, found '1e0'"},
        {"NumberOfPoints=\"5\"", "NumberOfPoints=\"6\"", SFEM_FORMAT, "expected a coordinate, but the data ends"},
        {"NumberOfPoints=\"5\"", "NumberOfPoints=\"99999\"", SFEM_FORMAT, "Points has less than 299997 numbers"},
        {"NumberOfPoints=\"5\"", "NumberOfPoints=\"-5\"", SFEM_FORMAT, "NumberOfPoints is -5"},
        {"NumberOfPoints=\"5\"", "NumberOfPoints=\"99999999999\"", SFEM_TOO_LARGE, "more than 2^31 - 1"},
        {"NumberOfCells=\"3\"", "NumberOfCells=\"2\"", SFEM_FORMAT, "found"},
        {"NumberOfCells=\"3\"", "NumberOfCells=\"2147483647\"", SFEM_FORMAT, "offsets has less than 2147483647 numbers"},
        {"\"3\"\n Name=\"Points\"", "\"2\"\n Name=\"Points\"", SFEM_FORMAT, "points of 2 components, not 3"},
        {"type=\"Float32\"", "type=\"String\"", SFEM_FORMAT, "expected a type of VTK, found 'String'"},
        {"type=\"Float32\"", "", SFEM_FORMAT, "expected a type of VTK"},
        {"1e0 1.", "1e0 nan", SFEM_NOT_FINITE, "a coordinate is not finite"},
        {"1e0 1.", "1e0 x", SFEM_FORMAT, "expected a coordinate, found 'x'"},
        {"1 2 3 4</", "1 2 3 5</", SFEM_BAD_MESH, "tet 1 names node 5, the mesh has 5"},
        {"1 2 3 4</", "1 2 3 -1</", SFEM_BAD_MESH, "tet 1 names node -1"},
        {"4 7 11", "4 3 11", SFEM_FORMAT, "an offset is 3, not in 4"},
        {"4 7 11", "4 7 10", SFEM_FORMAT, "cell 2 of type 10 has 3 nodes, not 4"},
        {"4 7 11", "4 7 2000000000", SFEM_FORMAT, "connectivity has less than 2000000000 numbers"},
        {"10 5 10", "10 5 12", SFEM_FORMAT, "cell 2 of type 12 has 4 nodes, not 8"},
        {"10 5 10", "9 5 9", SFEM_BAD_MESH, "5 triangles, but no 4-node tets"},
        {"\n4 7 5\n", "\n4 7\n", SFEM_FORMAT, "expected the region of a cell"},
        {"\n4 7 5\n", "\n4 7 9999999999\n", SFEM_FORMAT, "the region of a cell is 9999999999"},
        {"\"offsets\"", "\"Offsets2\"", SFEM_FORMAT, "the array offsets is missing"},
        {"\"offsets\"", "\"types\"", SFEM_FORMAT, "an array of the mesh a second time"},
        {"format=\"ascii\">4 7 11", "format=\"appended\" offset=\"0\">4 7 11", SFEM_FORMAT, "there is no AppendedData for offsets"},
        {"format=\"ascii\">4 7 11", "format=\"binary\">4 7 11", SFEM_FORMAT, "expected the size of an array"},
        {"format=\"ascii\">4 7 11", "format=\"binary\">4-7", SFEM_FORMAT, "offsets is not base64"},
        {"<!-- a > comment <DataArray -->", "<!-- a > comment <DataArray --", SFEM_FORMAT, "expected '-->', but the data ends"},
        {"</VTKFile>", "<a b=\"", SFEM_FORMAT, "a tag does not end"},
        {"</VTKFile>", "< >", SFEM_FORMAT, "a tag without a name"},
        {"<VTKFile type", "<VTK type", SFEM_FORMAT, "expected <VTKFile>, found 'VTK'"}};
    static const fault appended[] = {
        {"offset=\"0\"", "offset=\"99999\"", SFEM_FORMAT, "Points is beyond the end of AppendedData"},
        {"offset=\"0\"", "offset=\"-1\"", SFEM_FORMAT, "offset is -1"},
        {"offset=\"0\"", "offset=\"4\"", SFEM_FORMAT, "Points has"},
        {"NumberOfPoints=\"5\"", "NumberOfPoints=\"6\"", SFEM_FORMAT, "Points has 120 bytes, not 144"},
        {"NumberOfPoints=\"5\"", "NumberOfPoints=\"2147483647\"", SFEM_FORMAT, "Points has 120 bytes"},
        {"NumberOfCells=\"3\"", "NumberOfCells=\"2147483647\"", SFEM_FORMAT, "offsets has 24 bytes"},
        {"type=\"Float64\"", "type=\"Float32\"", SFEM_FORMAT, "Points has 120 bytes"},
        {"\"UInt64\"", "\"UInt32\"", SFEM_FORMAT, "an offset is"},
        {"encoding=\"base64\"", "encoding=\"raw\"", SFEM_FORMAT, "Points has"}};
    static mesh_file f;
    (void)state;
    mesh_file_sample(VTU, &f);
    f.data[f.n] = 0;
    refuse_each((const char *)f.data, faults, TEST_COUNT(faults));
    mesh_file_sample(VTU_APPENDED, &f);
    f.data[f.n] = 0;
    refuse_each((const char *)f.data, appended, TEST_COUNT(appended));
}

static void malformed_inp_is_refused(void **state)
{
    static const fault faults[] = {
        {"10, 0., 0., 0.", "10, 0., 0.", SFEM_FORMAT, "expected a coordinate, but the line ends"},
        {"10, 0., 0., 0.", "10, 0., nan, 0.", SFEM_NOT_FINITE, "line 5: a coordinate is not finite"},
        {"10, 0., 0., 0.", "0, 0., 0., 0.", SFEM_FORMAT, "the number of a node is 0"},
        {"10, 0., 0., 0.", "x, 0., 0., 0.", SFEM_FORMAT, "expected the number of a node, found 'x'"},
        {"10, 0., 0., 0.", "11, 0., 0., 0.", SFEM_FORMAT, "node 11 a second time"},
        {"2, 10, 11, 12, 13", "2, 10, 11, 12, 14", SFEM_BAD_MESH, "an element names node 14, which is not above"},
        {"2, 10, 11, 12, 13", "2, 10, 11, 12", SFEM_FORMAT, "expected a node of an element, found '*ELEMENT'"},
        {"3, 11, 12,\n", "2, 11, 12,\n", SFEM_FORMAT, "element 2 a second time"},
        {"TYPE=C3D4,", "", SFEM_FORMAT, "*ELEMENT without a TYPE="},
        {"*NODE, NSET=ALL", "*NOD", SFEM_BAD_MESH, "which is not above"},
        {"10, 12,\n20\n", "10, 12,\n21\n", SFEM_BAD_MESH, "a set names node 21, which is not there"},
        {"10, 12,\n20\n", "10, 12.5\n", SFEM_FORMAT, "expected a number in a set, found '12.5'"},
        {"some, odd", "some, even", SFEM_FORMAT, "there is no set 'even'"},
        {"NSET=some\n", "\n", SFEM_FORMAT, "a set without a name"},
        {"11, 19, 2", "11, 19, 0", SFEM_FORMAT, "the step is 0"},
        {"11, 19, 2", "11", SFEM_FORMAT, "expected the last number, but the line ends"},
        {"MATERIAL=rubber\n1.", "MATERIAL=wood\n1.", SFEM_FORMAT, "a *SOLID SECTION names 'wood', which is not there"},
        {"Elset=HARD", "Elset=HARDER", SFEM_FORMAT, "a *SOLID SECTION names 'HARDER', which is not there"},
        {"Elset=HARD,", "", SFEM_FORMAT, "*SOLID SECTION without an ELSET="},
        {"1e6, 0.45", "soft", SFEM_FORMAT, "expected Young's modulus, found 'soft'"},
        {"1e6, 0.45", "1e6, inf", SFEM_NOT_FINITE, "Poisson's ratio is not finite"},
        {"950.,", "1e999", SFEM_NOT_FINITE, "the density is too large"},
        {"*STEP", "*NGEN\n1, 2\n*STEP", SFEM_FORMAT, "*NGEN is not read: write all nodes and elements"},
        {"*STEP", "*INCLUDE, INPUT=b.inp\n*STEP", SFEM_FORMAT, "*INCLUDE b.inp: there is no file to include from"},
        {"*STEP", "*PART, NAME=a\n*END PART\n*PART, NAME=b\n*STEP", SFEM_FORMAT, "a second *PART"},
        {"*STEP", "*INSTANCE, NAME=a\n1, 0, 0\n*STEP", SFEM_FORMAT, "an *INSTANCE that is moved"}};
    static mesh_file f;
    (void)state;
    mesh_file_sample(INP, &f);
    f.data[f.n] = 0;
    refuse_each((const char *)f.data, faults, TEST_COUNT(faults));
    refuse("*HEADING\n", 9, NULL, SFEM_FORMAT, "there are no *NODE");
    refuse("*NODE\n1,0,0,0\n", 14, NULL, SFEM_BAD_MESH, "there are 1 nodes, but no 4-node tets");
}

/* Numbers of binary files replaced: the first place where `old` stands, of so many bytes, by `by`. */
static void refuse_bits(int sample, int bytes, uint64_t old, uint64_t by, sfem_status status, const char *words)
{
    static mesh_file f, wanted;
    size_t at;
    mesh_file_sample(sample, &f);
    wanted.big = f.big;
    wanted.n = 0;
    mesh_file_bits(&wanted, old, bytes);
    mesh_file_bits(&wanted, by, bytes);
    for (at = 0; at + (size_t)bytes <= f.n && memcmp(f.data + at, wanted.data, (size_t)bytes) != 0;) ++at;
    if (at + (size_t)bytes > f.n) fail_msg("there is no %llu in sample %d", (unsigned long long)old, sample);
    memcpy(f.data + at, wanted.data + bytes, (size_t)bytes);
    refuse(f.data, f.n, NULL, status, words);
}

static void malformed_binary_files_are_refused(void **state)
{
    const uint64_t nan = 0x7ff8000000000000u, one = 0x3ff0000000000000u;
    (void)state;
    refuse_bits(VTK_OLD, 4, 0x3f800000u, 0x7f800000u, SFEM_NOT_FINITE, "a coordinate is not finite");
    refuse_bits(VTK_NEW, 8, one, nan, SFEM_NOT_FINITE, "a coordinate is not finite");
    refuse_bits(VTK_NEW, 8, 11, 12, SFEM_FORMAT, "an offset is 12, not in 7 .. 11");
    refuse_bits(VTK_NEW, 8, 4, ~(uint64_t)0, SFEM_FORMAT, "an offset is -1");
    refuse_bits(VTU_RAW, 8, one, nan, SFEM_NOT_FINITE, "byte ");
    refuse_bits(VTU_RAW, 8, 120, 121, SFEM_FORMAT, "Points has 121 bytes");
    refuse_bits(VTU_RAW, 8, 120, ~(uint64_t)0, SFEM_FORMAT, "Points has -1 bytes");
    refuse_bits(VTU_RAW, 8, 11, 1u << 30, SFEM_FORMAT, "connectivity has 44 bytes");
    refuse_bits(MESHB, 4, 1, 2, SFEM_FORMAT, "only Gmsh");
    refuse_bits(MESHB + 1, 4, 2, 5, SFEM_FORMAT, "the version of Medit's format is 5");
    refuse_bits(MESHB + 1, 4, 3, 54, SFEM_FORMAT, "there are no Vertices");
    refuse_bits(MESHB + 2, 8, 24, 4, SFEM_FORMAT, "the next keyword is at byte 4, not behind this one");
    refuse_bits(MESHB + 2, 8, 24, 99999, SFEM_FORMAT, "the next keyword is at byte 99999");
    refuse_bits(MESHB + 2, 8, 24, 23, SFEM_FORMAT, "the dimension");
    refuse_bits(MESHB + 2, 4, 5, 1u << 28, SFEM_FORMAT, "the count of vertices is 268435456, more than");
    refuse_bits(MESHB + 3, 8, 5, (uint64_t)1 << 62, SFEM_FORMAT, "the count of vertices is 4611686018427387904, more than");
    refuse_bits(MESHB + 3, 8, 5, ~(uint64_t)0, SFEM_FORMAT, "the count of vertices is -1");
    refuse_bits(MESHB + 1, 8, one, nan, SFEM_NOT_FINITE, "a coordinate is not finite");
}

/* Cut at every byte: refused with a sentence, or the whole mesh, where only what stands behind it is lost. */
static void a_file_cut_anywhere_is_refused_or_whole(void **state)
{
    static mesh_file f;
    int k;
    (void)state;
    for (k = 0; k < MESH_FILES; ++k) {
        size_t n, whole = 0;
        const char *name = mesh_file_sample(k, &f);
        for (n = 0; n < f.n; ++n) {
            unsigned char *cut = (unsigned char *)malloc(n + 1);
            test_memory memory = {0};
            sfem_mesh_read_def def = sfem_default_mesh_read_def();
            sfem_error err = {SFEM_OK, -1, -1, -1, ""};
            parsed p;
            def.allocator = test_allocator(&memory);
            memcpy(cut + 1, f.data, n);
            if (sfem_mesh_parse_sets(cut + 1, n, &def, &p.m, &p.s, &p.info, &err) == SFEM_OK) {
                /* Abaqus ends anywhere, with the tets that are there then */
                if (k != INP && k != PART)
                    assert_sample(&p.m);
                else
                    assert_true(p.m.tets == 1 || p.m.tets == 2);
                ++whole;
                drop(&p);
            } else
                assert_true(err.text[0] != 0);
            assert_no_leak(memory);
            assert_true(memory.peak < 200 * n + 20000);
            free(cut);
        }
        if (k >= VTU && k <= VTU_APPENDED && whole > 60) fail_msg("%s: %d cuts are read", name, (int)whole);
    }
}

/* ---- what takes long, or goes deep ---- */

static void sets_of_abaqus_cannot_grow_without_end(void **state)
{
    enum { N = 3000 };
    char *text = (char *)malloc(400000), *p = text;
    int i;
    (void)state;
    p += sprintf(p, "*NODE\n");
    for (i = 1; i <= N; ++i) p += sprintf(p, "%d,%d,%d,%d\n", i, i == 2, i == 3, i == 4);
    p += sprintf(p, "*ELEMENT,TYPE=C3D4\n1,1,2,3,4\n");
    sprintf(p, "*NSET,NSET=a,GENERATE\n1,%d\n*NSET,NSET=b\nb,a,B\n*NSET,NSET=a\nb\n", N); /* each in the other */
    {
        parsed q = parse_text(text, NULL);
        assert_int_equal(sfem_mesh_sets_find(&q.s, "a", 0)->count, N);
        assert_int_equal(sfem_mesh_sets_find(&q.s, "b", 0)->count, N);
        drop(&q);
    }
    p += sprintf(p, "*NSET,NSET=a,GENERATE\n");
    for (i = 0; i < 4000; ++i) p += sprintf(p, "1,2147483647\n");
    refuse(text, (size_t)(p - text), NULL, SFEM_TOO_LARGE, "4 ");
    p = strstr(text, "*NSET");
    p += sprintf(p, "*NSET,NSET=s0\n1,2\n");
    for (i = 1; i < 60; ++i) p += sprintf(p, "*NSET,NSET=s%d\ns%d,s%d\n", i, i - 1, i - 1); /* 2^60 members */
    refuse(text, (size_t)(p - text), NULL, SFEM_TOO_LARGE, "4 a byte of the file");
    p = strstr(text, "*NSET");
    p += sprintf(p, "*NSET,NSET=a,GENERATE\n"); /* numbers that are not there are tried, too */
    for (i = 0; i < 4000; ++i) p += sprintf(p, "%d,%d\n", 10000, 10000 + 2000);
    refuse(text, (size_t)(p - text), NULL, SFEM_TOO_LARGE, "GENERATE of more than 4 numbers");
    free(text);
}

static void files_of_many_small_things_take_time_as_their_bytes(void **state)
{
    enum { N = 400000 };
    char *text = (char *)malloc(64 * (size_t)N), *p = text;
    parsed q;
    int i;
    (void)state;
    for (i = 0; i < N; ++i) p += sprintf(p, "<a b='"), p += sprintf(p, "'>");
    sprintf(p, "<!--");
    refuse(text, strlen(text), NULL, SFEM_FORMAT, "only Gmsh");
    p = text + sprintf(text, "<VTKFile type='UnstructuredGrid'><Piece NumberOfPoints='1' NumberOfCells='0'><CellData>");
    for (i = 0; i < N; ++i) p += sprintf(p, "<DataArray type='Int8' Name='region'>");
    refuse(text, strlen(text), NULL, SFEM_FORMAT, "the array Points is missing");
    p = text + sprintf(text, "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT,TYPE=C3D4\n1,1,2,3,4\n");
    for (i = 0; i < N; ++i) p += sprintf(p, "*NSET,NSET=s%d\n%d\n", i, 1 + i % 4);
    q = parse_text(text, NULL);
    assert_int_equal(q.s.sets, N);
    assert_set(&q, "s399999", 0, "3");
    drop(&q);
    p = text + sprintf(text, "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT,TYPE=C3D4\n1,1,2,3,4");
    for (i = 0; i < N; ++i) p += sprintf(p, " ,,");
    p += sprintf(p, "\n*ELEMENT,TYPE=S3\n2,1,2,3");
    for (i = 0; i < N; ++i) p += sprintf(p, ",\n3");
    q = parse_text(text, NULL); /* an element of as many nodes */
    assert_int_equal(q.m.tets, 1);
    drop(&q);
    p = text + sprintf(text, "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$EndNodes\n"
                             "$Elements\n%d\n", N + 1);
    for (i = 0; i < N; ++i) p += sprintf(p, "%d 15 2 %d 1 %d\n", i + 1, i + 1, 1 + i % 4); /* each in a group of its own */
    sprintf(p, "%d 4 0 1 2 3 4\n$EndElements\n", N + 1);
    q = parse_text(text, NULL);
    assert_int_equal(q.s.sets, N);
    assert_set(&q, "point 400000", 0, "3");
    drop(&q);
    free(text);
}

static void inp_includes_files_beside_it(void **state)
{
    static const char head[] = "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*INCLUDE, INPUT = test_formats_part.inp\n*STEP\n";
    const char *path = scratch_path("test_formats.inp"), *part = scratch_path("test_formats_part.inp");
    sfem_error err;
    parsed p;
    (void)state;
    scratch_write(path, head);
    scratch_write(part, "** the rest\n*ELEMENT,TYPE=C3D4,ELSET=a\n1,1,2,3,4\n*NSET,NSET=b\n2\n");
    assert_ok(sfem_mesh_read_sets(path, NULL, &p.m, &p.s, &p.info, &err), err);
    assert_int_equal(p.m.tets, 1);
    assert_set(&p, "b", 0, "1");
    drop(&p);
    scratch_write(part, "*INCLUDE, INPUT=test_formats_part.inp\n"); /* itself */
    assert_status(sfem_mesh_read_sets(path, NULL, &p.m, &p.s, &p.info, &err), SFEM_TOO_LARGE);
    assert_names(err, "more than 16 files are included");
    scratch_write(part, "*INCLUDE, INPUT=../test_formats_part.inp\n");
    assert_status(sfem_mesh_read_sets(path, NULL, &p.m, &p.s, &p.info, &err), SFEM_FORMAT);
    assert_names(err, "not a file beside this one");
    scratch_write(part, "*INCLUDE, INPUT=none.inp\n");
    assert_status(sfem_mesh_read_sets(path, NULL, &p.m, &p.s, &p.info, &err), SFEM_IO);
    remove(path);
    remove(part);
}

static void changed_files_do_no_harm(void **state)
{
    test_random random = {41};
    static mesh_file f;
    int i, k, read = 0;
    (void)state;
    for (i = 0; i < 60000; ++i) {
        test_memory memory = {0};
        sfem_mesh_read_def def = sfem_default_mesh_read_def();
        sfem_error err = {SFEM_OK, -1, -1, -1, ""};
        unsigned char *copy;
        parsed p;
        mesh_file_sample(i % MESH_FILES, &f);
        for (k = 1 + random_below(&random, 3); k > 0; --k) {
            const size_t at = (size_t)random_below(&random, (sfem_int)f.n), length = 1 + (size_t)random_below(&random, 9);
            const size_t from = (size_t)random_below(&random, (sfem_int)f.n);
            switch (random_below(&random, 4)) {
            case 0: f.data[at] = (unsigned char)random_bits(&random); break;
            case 1: f.data[at] = (unsigned char)"0123456789-.,*<>\"=\n /"[random_below(&random, 21)]; break;
            case 2:
                if (at + length > f.n) break;
                memmove(f.data + at, f.data + at + length, f.n - at - length);
                f.n -= length;
                break;
            default:
                if (at + length <= f.n && from + length <= f.n) memmove(f.data + at, f.data + from, length);
            }
        }
        copy = (unsigned char *)malloc(f.n);
        memcpy(copy, f.data, f.n);
        def.allocator = test_allocator(&memory);
        def.linear = i % 2;
        def.weld = i % 3 == 0;
        if (sfem_mesh_parse_sets(copy, f.n, &def, &p.m, &p.s, &p.info, &err) == SFEM_OK) {
            for (k = 0; k < 4 * p.m.tets; ++k) assert_in_range(p.m.tet[k], 0, p.m.nodes - 1);
            for (k = 0; k < 3 * p.m.nodes; ++k) assert_true(isfinite(p.m.x[k]));
            drop(&p);
            ++read;
        } else
            assert_true(err.text[0] != 0);
        assert_no_leak(memory);
        assert_true(memory.peak < 200 * f.n + 20000);
        free(copy);
    }
    assert_true(read > 6000);
}

/* ---- memory ---- */

static sfem_status do_parse(sfem_allocator allocator, void *user, sfem_error *err)
{
    const int which = *(const int *)user;
    sfem_mesh_read_def def = sfem_default_mesh_read_def();
    static mesh_file f;
    sfem_status status;
    parsed p;
    def.allocator = allocator;
    def.weld = 1;
    def.linear = 1;
    if (which >= MESH_FILES + (int)TEST_COUNT(quadratic)) {
        sfem_surface s;
        mesh_file_sample(VTU_RAW, &f);
        status = sfem_surface_parse(f.data, f.n, &allocator, &s, err);
        if (status == SFEM_OK) sfem_surface_free(&s);
        return status;
    }
    if (which < MESH_FILES) {
        mesh_file_sample(which, &f);
        status = sfem_mesh_parse_sets(f.data, f.n, &def, &p.m, &p.s, &p.info, err);
    } else {
        const char *text = quadratic[which - MESH_FILES];
        status = sfem_mesh_parse_sets(text, strlen(text), &def, &p.m, &p.s, &p.info, err);
    }
    if (status == SFEM_OK) drop(&p);
    return status;
}

static sfem_status do_weld(sfem_allocator allocator, void *user, sfem_error *err)
{
    sfem_mesh m = two_blocks(0.01);
    sfem_status status;
    sfem_mesh_report r;
    m.allocator = allocator;
    if (*(const int *)user)
        status = sfem_mesh_weld(&m, 0.1, NULL, NULL, err);
    else {
        memcpy(m.x + 24, m.x, 24 * sizeof *m.x); /* all twice */
        status = sfem_mesh_check(&m, &r, err);
    }
    free_blocks(&m);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    int which;
    (void)state;
    for (which = 0; which <= MESH_FILES + (int)TEST_COUNT(quadratic); ++which)
        assert_true(fail_every_allocation(do_parse, &which) >= 3);
    for (which = 0; which < 2; ++which) assert_true(fail_every_allocation(do_weld, &which) >= 3);
}

/* ---- files of other programs that have more in them than tets ---- */

/* Six points, a tet, then cells that the caller gives; regions behind what else may stand there, by an array "region". */
static const char vtk_head[] = "# vtk DataFile Version 4.2\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 double\n"
                               "0 0 0 1 0 0 0 1 0 0 0 1 1 1 1\n";

static void regions_are_found_behind_arrays_of_any_kind(void **state)
{
    static const char *const before[] = {
        "FIELD FieldData 3\nname 1 2 string\na b\n\nMETADATA\nINFORMATION 0\n\nflag 1 2 bit\n1 0\n",
        "COLOR_SCALARS c 3\n0 0 0 1 1 1\nFIELD f 1\n", "TEXTURE_COORDINATES t 2 float\n0 0 1 1\nFIELD f 1\n",
        "SCALARS s float 1\nLOOKUP_TABLE lut\n0 1\nLOOKUP_TABLE lut 2\n0 0 0 1 1 1 1 1\nFIELD f 1\n"};
    char text[1000];
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(before); ++k) {
        parsed p;
        sprintf(text, "%sCELLS 2 10\n4 0 1 2 3 4 1 2 3 4\nCELL_TYPES 2\n10 10\nCELL_DATA 2\n%sregion 1 2 int\n7 -9\n", vtk_head,
                before[k]);
        p = parse_text(text, NULL);
        if (!p.m.region) fail_msg("no regions behind %s", before[k]);
        assert_int_equal(p.m.region[0], 7);
        assert_int_equal(p.m.region[1], -9);
        drop(&p);
    }
}

static void put(char *to, size_t *n, const void *data, size_t bytes)
{
    memcpy(to + *n, data, bytes);
    *n += bytes;
}

static void put_text(char *to, size_t *n, const char *text) { put(to, n, text, strlen(text)); }

static void put_numbers(char *to, size_t *n, const int *v, int count) /* high bytes first */
{
    int i, b;
    for (i = 0; i < count; ++i)
        for (b = 24; b >= 0; b -= 8) to[(*n)++] = (char)(v[i] >> b & 255);
}

static void regions_are_found_behind_binary_bits_and_strings(void **state)
{
    static const char head[] = "# vtk DataFile Version 4.2\nt\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 int\n";
    static const int x[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}, cells[15] = {4, 0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1, 2, 3};
    static const int types[3] = {10, 10, 10}, region[3] = {5, 70000, -1}, length = 0x40000000 + 70;
    char text[1000], begun[1000], longer[70];
    size_t n = 0, k;
    parsed p;
    (void)state;
    memset(longer, 'x', sizeof longer);
    put_text(text, &n, head);
    put_numbers(text, &n, x, 12);
    put_text(text, &n, "\nCELLS 3 15\n");
    put_numbers(text, &n, cells, 15);
    put_text(text, &n, "\nCELL_TYPES 3\n");
    put_numbers(text, &n, types, 3);
    put_text(text, &n, "\nCELL_DATA 3\nFIELD f 3\nname 1 3 string\n");
    put_text(text, &n, "\xc2" "a\n"); /* one byte of length 2 */
    put_numbers(text, &n, &length, 1); /* four */
    put(text, &n, longer, sizeof longer);
    put_text(text, &n, "\x80\x41"); /* two */
    put(text, &n, longer, 65); /* 0x41 */
    put_text(text, &n, "\nflag 1 3 bit\n\x60\nregion 1 3 int\n");
    put_numbers(text, &n, region, 3);
    p = parse(text, n, NULL);
    assert_non_null(p.m.region);
    assert_memory_equal(p.m.region, region, sizeof region);
    drop(&p);
    for (k = n - 170; k < n; ++k) { /* cut short there: the mesh is whole, and there are no regions, or not these */
        memcpy(begun, text, k);
        p = parse(begun, k, NULL);
        assert_int_equal(p.m.tets, 3);
        drop(&p);
    }
}

static void polyhedra_and_cells_of_higher_order_are_volume_cells(void **state)
{
    static const int types[] = {42, 41, 37, 67, 71, 74, 78};
    char text[1000];
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(types); ++k) {
        sfem_surface s;
        sfem_error err;
        parsed p;
        sprintf(text,
                "%sCELLS 3 27\n4 0 1 2 3 17 4 3 0 1 2 3 0 1 3 3 1 2 3 3 0 2 3 3 0 1 2\nCELL_TYPES 3\n10 %d 5\nCELL_DATA 3\nFIELD f 1\n"
                "region 1 3 int\n1 8 9\n",
                vtk_head, types[k]);
        p = parse_text(text, NULL);
        assert_int_equal(p.info.others, 1);
        assert_int_equal(p.s.sets, 1);
        assert_set(&p, "surface 9", 0, "0 1 2");
        drop(&p);
        text[strlen(vtk_head) + 24] = '9'; /* of a polyhedron not all numbers are nodes */
        assert_ok(sfem_surface_parse(text, strlen(text), NULL, &s, &err), err);
        assert_int_equal(s.triangles, 1);
        sfem_surface_free(&s);
    }
}

static void medit_may_have_a_section_of_tets_for_each_part(void **state)
{
    static const char file[] = "MeshVersionFormatted 1\nDimension 3\nVertices 5\n0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 0 1 1 1 0\n"
                               "Tetrahedra 1\n1 2 3 4 6\nTriangles 1\n1 2 3 4\nTetrahedra 2\n2 3 4 5 7\n1 2 3 4 8\nEnd\n";
    static const sfem_int region[3] = {6, 7, 8}, second[4] = {1, 2, 3, 4};
    char many[40000], *q;
    parsed p = parse_text(file, NULL);
    int k;
    (void)state;
    assert_int_equal(p.m.tets, 3);
    assert_memory_equal(p.m.region, region, sizeof region);
    assert_memory_equal(p.m.tet + 4, second, sizeof second);
    assert_set(&p, "surface 4", 0, "0 1 2");
    drop(&p);
    q = many + sprintf(many, "MeshVersionFormatted 1\nDimension 3\nVertices 4\n0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 0\n");
    for (k = 0; k < 1000; ++k) q += sprintf(q, "Tetrahedra 1\n1 2 3 4 %d\n", k);
    p = parse_text(many, NULL);
    assert_int_equal(p.m.tets, 1000);
    for (k = 0; k < 1000; ++k) assert_int_equal(p.m.region[k], k);
    drop(&p);
    q += sprintf(q, "Tetrahedra 2\n1 2 3 4 5\n1 2 3 9 0\n");
    refuse(many, strlen(many), NULL, SFEM_BAD_MESH, "tet 1001 names vertex 9");
}

static void abaqus_has_fortran_numbers_and_names_as_they_are_written(void **state)
{
    parsed p = parse_text("*NODE\n1, 0, 0, 0\n2, 1.5D1, 0, 0\n3, 0, 25d-1, 0\n4, 0, 0, 1E0\n*ELEMENT, TYPE=C3D4\n9, 1, 2, 3, 4\n"
                          "*ELSET, ELSET=\"Upper Part\"\n9\n*NSET, NSET=Base\n1, 2\n*ELSET, elset=UPPER PART\n9\n",
                          NULL);
    (void)state;
    assert_true(p.m.x[3] == 15 && p.m.x[7] == 2.5 && p.m.x[11] == 1);
    assert_int_equal(p.s.sets, 2);
    assert_string_equal(sfem_mesh_sets_find(&p.s, "upper part", 1)->name, "Upper Part");
    assert_string_equal(sfem_mesh_sets_find(&p.s, "BASE", 0)->name, "Base");
    drop(&p);
}

static void what_is_not_read_is_told_by_its_name(void **state)
{
    static const struct {
        const char *text;
        sfem_status status;
        const char *words;
    } table[] = {
        {"$NOD\n4\n1 0 0 0\n", SFEM_FORMAT, "Gmsh 1: only 2.0 to 2.2 and 4.1"},
        {"$ Created by a program\nBEGIN BULK\n", SFEM_FORMAT, "are read, this begins with '$'"},
        {"$$ comment\nBEGIN BULK\n", SFEM_FORMAT, "are read, this begins with '$$'"},
        {"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$ParametricNodes\n0\n$EndParametricNodes\n", SFEM_FORMAT,
         "$ParametricNodes: write the file without Mesh.SaveParametric, or as 4.1"},
        {"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$EndNodes\n$Elements\n2\n"
         "1 2 1 0 1 2 3\n2 29 1 0 1 2 3 4 1 2 3 4 1 2 3 4 1 2 3 4 1 2 3 4\n$EndElements\n",
         SFEM_BAD_MESH, "there are 1 volume cells, but none is a tet of 4 or 10 nodes"},
        {"MeshVersionFormatted 1\nDimension 3\nVertices 1\n0 0 0 0\nHexahedra 1\n1 1 1 1 1 1 1 1 0\nEnd\n", SFEM_BAD_MESH,
         "there are 1 volume cells, but none is a tet of 4 or 10 nodes"},
        {"# vtk DataFile Version 4.2\nt\nASCII\nDATASET POLYDATA\n", SFEM_FORMAT, "'POLYDATA': write surfaces as .ply"},
        {"<VTKFile type=\"PolyData\">", SFEM_FORMAT, "only UnstructuredGrid is read; write surfaces as .ply"},
        {"<VTKFile type=\"ImageData\">", SFEM_FORMAT, "a VTK file of ImageData: only UnstructuredGrid is read"}};
    size_t k;
    (void)state;
    for (k = 0; k < TEST_COUNT(table); ++k)
        refuse(table[k].text, strlen(table[k].text), NULL, table[k].status, table[k].words);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_same_mesh_comes_from_each_file),
        cmocka_unit_test(names_of_gmsh_and_vega_and_medit_are_those_of_sets_and_regions),
        cmocka_unit_test(elements_of_a_wrong_dimension_are_in_no_set),
        cmocka_unit_test(sets_and_materials_of_abaqus_are_read),
        cmocka_unit_test(tets_of_10_nodes_are_linear_on_request),
        cmocka_unit_test(medit_and_tetgen_have_tets_of_10_nodes),
        cmocka_unit_test(triangles_of_a_mesh_file_are_a_surface),
        cmocka_unit_test(what_is_written_comes_back),
        cmocka_unit_test(a_seam_is_reported_and_welded),
        cmocka_unit_test(a_weld_that_would_spoil_a_tet_changes_nothing),
        cmocka_unit_test(welding_within_a_distance_agrees_with_all_pairs),
        cmocka_unit_test(a_file_is_welded_on_request_with_its_sets),
        cmocka_unit_test(malformed_vtu_is_refused),
        cmocka_unit_test(malformed_inp_is_refused),
        cmocka_unit_test(malformed_binary_files_are_refused),
        cmocka_unit_test(a_file_cut_anywhere_is_refused_or_whole),
        cmocka_unit_test(sets_of_abaqus_cannot_grow_without_end),
        cmocka_unit_test(files_of_many_small_things_take_time_as_their_bytes),
        cmocka_unit_test(inp_includes_files_beside_it),
        cmocka_unit_test(regions_are_found_behind_arrays_of_any_kind),
        cmocka_unit_test(regions_are_found_behind_binary_bits_and_strings),
        cmocka_unit_test(polyhedra_and_cells_of_higher_order_are_volume_cells),
        cmocka_unit_test(medit_may_have_a_section_of_tets_for_each_part),
        cmocka_unit_test(abaqus_has_fortran_numbers_and_names_as_they_are_written),
        cmocka_unit_test(what_is_not_read_is_told_by_its_name),
        cmocka_unit_test(changed_files_do_no_harm),
        cmocka_unit_test(every_allocation_may_fail),
    };
    return run_all_tests(tests);
}
