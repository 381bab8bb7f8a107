/* Mesh files: what is read, what is refused and where, what is written. */
#include "support.h"
#include <locale.h>

/* ---- texts ---- */

/* node tags with gaps and in disorder, one of them unused; a triangle; two tets, one left-handed */
static const char *const gmsh_lines[] = {
    "$MeshFormat",      /* 1 */
    "4.1 0 8",          /* 2 */
    "$EndMeshFormat",   /* 3 */
    "$Nodes",           /* 4 */
    "2 6 1 90000000",   /* 5 */
    "2 1 0 2",          /* 6 */
    "90000000",         /* 7 */
    "7",                /* 8 */
    "0 0 0",            /* 9 */
    "1 0 0",            /* 10 */
    "3 1 0 4",          /* 11 */
    "3",                /* 12 */
    "2",                /* 13 */
    "1",                /* 14 */
    "8",                /* 15 */
    "0 1 0",            /* 16 */
    "0 0 1",            /* 17 */
    "5e0 5. +.5E+1",    /* 18 */
    "0 0 -1",           /* 19 */
    "$EndNodes",        /* 20 */
    "$Elements",        /* 21 */
    "2 3 1 3",          /* 22 */
    "2 1 2 1",          /* 23 */
    "1 90000000 7 3",   /* 24 */
    "3 4 4 2",          /* 25 */
    "2 90000000 7 3 2", /* 26 */
    "3 90000000 7 3 8", /* 27 */
    "$EndElements",     /* 28 */
    NULL,
};

static const char *const vtk_lines[] = {
    "# vtk DataFile Version 3.0", /* 1 */
    "a title",                    /* 2 */
    "ASCII",                      /* 3 */
    "DATASET UNSTRUCTURED_GRID",  /* 4 */
    "POINTS 6 double",            /* 5 */
    "0 0 0 1 0 0 0 1",            /* 6 */
    "0 0 0 1",                    /* 7 */
    "5 5 5",                      /* 8 */
    "0 0 -1",                     /* 9 */
    "CELLS 3 14",                 /* 10 */
    "4 0 1 2 3",                  /* 11 */
    "3 0 1 2",                    /* 12 */
    "4 0 1 2 5",                  /* 13 */
    "CELL_TYPES 3",               /* 14 */
    "10",                         /* 15 */
    "5",                          /* 16 */
    "10",                         /* 17 */
    NULL,
};

static const char *const vtk5_lines[] = {
    "# vtk DataFile Version 5.1", /* 1 */
    "vtk output",                 /* 2 */
    "ASCII",                      /* 3 */
    "DATASET UNSTRUCTURED_GRID",  /* 4 */
    "POINTS 6 float",             /* 5 */
    "0 0 0 1 0 0 0 1 0",          /* 6 */
    "0 0 1 5 5 5 0 0 -1",         /* 7 */
    "METADATA",                   /* 8 */
    "INFORMATION 0",              /* 9 */
    "",                           /* 10 */
    "CELLS 4 11",                 /* 11 */
    "OFFSETS vtktypeint64",       /* 12 */
    "0 4 7",                      /* 13 */
    "11",                         /* 14 */
    "CONNECTIVITY vtktypeint64",  /* 15 */
    "0 1 2 3 0 1 2",              /* 16 */
    "0 1 2 5",                    /* 17 */
    "CELL_TYPES 3",               /* 18 */
    "10",                         /* 19 */
    "5",                          /* 20 */
    "10",                         /* 21 */
    NULL,
};

static const char *const gmsh2_lines[] = {
    "$MeshFormat",                  /* 1 */
    "2.2 0 8",                      /* 2 */
    "$EndMeshFormat",               /* 3 */
    "$PhysicalNames",               /* 4 */
    "1",                            /* 5 */
    "3 1 \"body\"",                 /* 6 */
    "$EndPhysicalNames",            /* 7 */
    "$Nodes",                       /* 8 */
    "6",                            /* 9 */
    "90000000 0 0 0",               /* 10 */
    "7 1 0 0",                      /* 11 */
    "3 0 1 0",                      /* 12 */
    "2 0 0 1",                      /* 13 */
    "1 5e0 5. +.5E+1",              /* 14 */
    "8 0 0 -1",                     /* 15 */
    "$EndNodes",                    /* 16 */
    "$Elements",                    /* 17 */
    "3",                            /* 18 */
    "1 2 2 0 2 90000000 7 3",       /* 19 */
    "2 4 2 0 4 90000000 7 3 2",     /* 20 */
    "3 4 4 0 4 1 9 90000000 7 3 8", /* 21 */
    "$EndElements",                 /* 22 */
    NULL,
};

static const char *const veg_lines[] = {
    "# a comment",         /* 1 */
    "*VERTICES",           /* 2 */
    "6 3 0 0",             /* 3 */
    "1 0 0 0",             /* 4 */
    "2, 1, 0, 0",          /* 5 */
    "3 0 1 0",             /* 6 */
    "4 0 0 1 # a comment", /* 7 */
    "5 5e0 5. +.5E+1",     /* 8 */
    "6 0 0 -1",            /* 9 */
    "*ELEMENTS",           /* 10 */
    "TET",                 /* 11 */
    "2 4 0",               /* 12 */
    "1 1 2 3 4",           /* 13 */
    "2 1 2 3 6",           /* 14 */
    "*MATERIAL soft",      /* 15 */
    "ENU, 1000, 1e6, .45", /* 16 */
    "*MATERIAL very hard", /* 17 */
    "ENU, 2e3, 1e9, 0.3",  /* 18 */
    "*SET one",            /* 19 */
    "2,",                  /* 20 */
    "*REGION",             /* 21 */
    "allElements, soft",   /* 22 */
    "*REGION",             /* 23 */
    "one, very hard",      /* 24 */
    NULL,
};

static const char *const node_lines[] = {
    "# a comment",       /* 1 */
    "6 3 1 1",           /* 2 */
    "1 0 0 0 .5 1",      /* 3 */
    "2 1 0 0 .5 0",      /* 4 */
    "3 0 1 0 .5 0 # c",  /* 5 */
    "",                  /* 6 */
    "4 0 0 1 .5 1",      /* 7 */
    "5 5e0 5. 5 1e-1 1", /* 8 */
    "6 0 0 -1 0 1",      /* 9 */
    NULL,
};

static const char *const ele_lines[] = {
    "2 4 1",       /* 1 */
    "1 1 2 3 4 4", /* 2 */
    "2 1 2 3 6 4", /* 3 */
    "# the end",   /* 4 */
    NULL,
};

static const char *const medit_lines[] = {
    "# a comment",            /* 1 */
    "MeshVersionFormatted 2", /* 2 */
    "Dimension",              /* 3 */
    "3",                      /* 4 */
    "Vertices",               /* 5 */
    "6 # a comment",          /* 6 */
    "0 0 0 0",                /* 7 */
    "1d0 0 0 0",              /* 8 */
    "0 1 0 -3",               /* 9 */
    "0 0 1 0",                /* 10 */
    "5D+0 50d-1 .5e+1 0",     /* 11 */
    "0 0 -1 99",              /* 12 */
    "Triangles 1",            /* 13 */
    "1 2 3 7",                /* 14 */
    "Normals",                /* 15 */
    "2",                      /* 16 */
    "0 0 1",                  /* 17 */
    "1 0 0",                  /* 18 */
    "NewInAVersionToCome 1",  /* 19 */
    "1 .5 -3",                /* 20 */
    "Tetrahedra",             /* 21 */
    "2",                      /* 22 */
    "1 2 3 4 4",              /* 23 */
    "1 2 3 6 5",              /* 24 */
    "End",                    /* 25 */
    NULL,
};

static const char *const *const all_lines[] = {gmsh_lines,  vtk_lines, vtk5_lines,
                                               gmsh2_lines, veg_lines, medit_lines};

/* The lines joined, line number `line` replaced; with NULL the text ends before it. Free it. */
static char *join(const char *const *lines, int line, const char *replacement, const char *newline)
{
    size_t bytes = 1;
    char *text;
    int i;
    for (i = 0; lines[i]; ++i) bytes += strlen(lines[i]) + strlen(newline);
    text = (char *)malloc(bytes + (replacement ? strlen(replacement) : 0) + strlen(newline));
    *text = 0;
    for (i = 0; lines[i]; ++i) {
        if (i == line - 1 && !replacement) break;
        strcat(text, i == line - 1 ? replacement : lines[i]);
        strcat(text, newline);
    }
    return text;
}

static const sfem_real wanted_x[18] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 5, 5, 5, 0, 0, -1};
static const sfem_int wanted_tets[8] = {0, 1, 2, 3, 0, 1, 5, 2}; /* the second one was turned */

static sfem_mesh parse(const char *text)
{
    sfem_error err;
    sfem_mesh m;
    assert_ok(sfem_mesh_parse(text, strlen(text), NULL, &m, &err), err);
    return m;
}

static void assert_wanted(const sfem_mesh *m)
{
    sfem_mesh_report r;
    sfem_error err;
    assert_int_equal(m->nodes, 6);
    assert_int_equal(m->tets, 2);
    assert_memory_equal(m->x, wanted_x, sizeof wanted_x);
    assert_memory_equal(m->tet, wanted_tets, sizeof wanted_tets);
    assert_ok(sfem_mesh_check(m, &r, &err), err);
    assert_int_equal(r.unused, 1);
}

/* ---- the same mesh in bytes ---- */

typedef struct binary {
    char data[2048];
    size_t n;
    int big, size, real; /* high bytes first; bytes of a count and of a real */
} binary;

static void put_bits(binary *b, uint64_t bits, int bytes)
{
    int i;
    for (i = 0; i < bytes; ++i)
        b->data[b->n++] = (char)(unsigned char)(bits >> 8 * (b->big ? bytes - 1 - i : i));
}

static void put_text(binary *b, const char *text)
{
    memcpy(b->data + b->n, text, strlen(text));
    b->n += strlen(text);
}

static void put_ints(binary *b, int count, const int *value)
{
    int i;
    for (i = 0; i < count; ++i) put_bits(b, (uint64_t)(int64_t)value[i], 4);
}

static void put_sizes(binary *b, int count, const int *value)
{
    int i;
    for (i = 0; i < count; ++i) put_bits(b, (uint64_t)(int64_t)value[i], b->size);
}

static void put_reals(binary *b, int count, const sfem_real *value)
{
    int i;
    for (i = 0; i < count; ++i) {
        const float f = (float)value[i];
        uint32_t low;
        uint64_t bits;
        memcpy(&low, &f, sizeof low);
        memcpy(&bits, value + i, sizeof bits);
        put_bits(b, b->real == 4 ? low : bits, b->real);
    }
}

static const int tag_of_node[6] = {90000000, 7, 3, 2, 1, 8};

static void put_format(binary *b, const char *version)
{
    const int one = 1;
    char text[64];
    snprintf(text, sizeof text, "$MeshFormat\n%s 1 %d\n", version,
             *version == '2' ? b->real : b->size);
    put_text(b, text);
    put_ints(b, 1, &one);
    put_text(b, "\n$EndMeshFormat\n");
}

static void put_gmsh2(binary *b)
{
    /* type, count, tags; tag, physical group, entity, nodes */
    static const int triangle[9] = {2, 1, 2, 1, 0, 2, 90000000, 7, 3};
    static const int tets[3 + 2 * 7] = {4, 2, 2, 2, 0,        4, 90000000, 7, 3,
                                        2, 3, 0, 4, 90000000, 7, 3,        8};
    int i;
    put_format(b, "2.2");
    put_text(b, "$Nodes\n6\n");
    for (i = 0; i < 6; ++i) {
        put_ints(b, 1, tag_of_node + i);
        put_reals(b, 3, wanted_x + 3 * i);
    }
    put_text(b, "$EndNodes\n$Elements\n3\n");
    put_ints(b, 9, triangle);
    put_ints(b, 17, tets);
    put_text(b, "\n$EndElements\n");
}

static void put_gmsh4(binary *b)
{
    static const int counts[4] = {1, 1, 0, 1}, nodes[4] = {2, 6, 1, 90000000};
    static const int first[3] = {2, 1, 0}, second[3] = {3, 1, 0}, two = 2, four = 4, one = 1;
    static const int elements[4] = {2, 3, 1, 3}, triangles[3] = {2, 1, 2}, tets[3] = {3, 4, 4};
    static const int rows[14] = {1, 90000000, 7, 3, 2, 90000000, 7, 3, 2, 3, 90000000, 7, 3, 8};
    static const int zero = 0, bounds[3] = {1, 5, -6};
    put_format(b, "4.1");
    put_text(b, "$Comments\nanything, $EndComment\n$EndComments\n$Entities\n");
    put_sizes(b, 4, counts);
    put_ints(b, 1, &one), put_reals(b, 3, wanted_x), put_sizes(b, 1, &one), put_ints(b, 1, &four);
    put_ints(b, 1, &one), put_reals(b, 6, wanted_x), put_sizes(b, 1, &zero);
    put_sizes(b, 1, &two), put_ints(b, 2, bounds + 1);
    put_ints(b, 1, &four), put_reals(b, 6, wanted_x), put_sizes(b, 1, &zero);
    put_sizes(b, 1, &one), put_ints(b, 1, bounds + 1);
    put_text(b, "\n$EndEntities\n$Nodes\n");
    put_sizes(b, 4, nodes);
    put_ints(b, 3, first), put_sizes(b, 1, &two);
    put_sizes(b, 2, tag_of_node), put_reals(b, 6, wanted_x);
    put_ints(b, 3, second), put_sizes(b, 1, &four);
    put_sizes(b, 4, tag_of_node + 2), put_reals(b, 12, wanted_x + 6);
    put_text(b, "\n$EndNodes\n$Elements\n");
    put_sizes(b, 4, elements);
    put_ints(b, 3, triangles), put_sizes(b, 1, &one), put_sizes(b, 4, rows);
    put_ints(b, 3, tets), put_sizes(b, 1, &two), put_sizes(b, 10, rows + 4);
    put_text(b, "\n$EndElements\n");
}

#define TEXTS   6
#define SAMPLES (TEXTS + 8)

/* The mesh in its texts, then in bytes: 2.2 with doubles and floats, 4.1 with sizes of 8 and 4, each
 * in either order. Free it. */
static char *sample(size_t which, size_t *bytes)
{
    const int i = (int)which - TEXTS;
    char *copy;
    binary b;
    if (which < TEXTS) {
        copy = join(all_lines[which], -1, NULL, "\n");
        *bytes = strlen(copy);
        return copy;
    }
    b.n = 0;
    b.big = i & 1;
    b.size = i < 4 || i & 2 ? 4 : 8;
    b.real = i < 4 && i & 2 ? 4 : 8;
    if (i < 4)
        put_gmsh2(&b);
    else
        put_gmsh4(&b);
    copy = (char *)malloc(b.n);
    memcpy(copy, b.data, b.n);
    *bytes = b.n;
    return copy;
}

/* ---- reading ---- */

static void the_same_mesh_comes_from_each_format(void **state)
{
    static const char *const newlines[] = {"\n", "\r\n", " \t\n", "\n\n"};
    size_t i, k;
    (void)state;
    for (i = 0; i < TEST_COUNT(all_lines); ++i)
        for (k = 0; k < TEST_COUNT(newlines); ++k) {
            char *text;
            sfem_mesh m;
            if ((i == 1 || i == 2) && k == 3) continue; /* an empty line means something in VTK */
            text = join(all_lines[i], -1, NULL, newlines[k]);
            m = parse(text);
            assert_wanted(&m);
            if (i == 0 || i == 3)
                assert_int_equal(m.region[0], 4); /* the entity's number */
            else if (i == 4)
                assert_true(m.region[0] == 0 && m.region[1] == 1);
            else if (i == 5)
                assert_true(m.region[0] == 4 && m.region[1] == 5);
            else
                assert_null(m.region);
            sfem_mesh_free(&m);
            free(text);
        }
}

static void the_same_mesh_comes_from_bytes_in_either_order(void **state)
{
    size_t i, bytes;
    (void)state;
    for (i = TEXTS; i < SAMPLES; ++i) {
        char *data = sample(i, &bytes);
        sfem_error err;
        sfem_mesh m;
        assert_ok(sfem_mesh_parse(data, bytes, NULL, &m, &err), err);
        assert_wanted(&m);
        assert_int_equal(m.region[0], 4);
        assert_int_equal(m.region[1], 4);
        sfem_mesh_free(&m);
        free(data);
    }
}

static void the_same_mesh_comes_from_the_two_files_of_tetgen(void **state)
{
    static const char node0[] = "6 3\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n4 5 5 5\n5 0 0 -1";
    static const char ele0[] = "2\n0 0 1 2 3\n1 0 1 2 5";
    char *node = join(node_lines, -1, NULL, "\r\n"), *ele = join(ele_lines, -1, NULL, "\r\n");
    sfem_error err;
    sfem_mesh m;
    (void)state;
    assert_ok(sfem_mesh_parse_tetgen(node, strlen(node), ele, strlen(ele), NULL, &m, &err), err);
    assert_wanted(&m);
    assert_int_equal(m.region[0], 4);
    assert_int_equal(m.region[1], 4);
    sfem_mesh_free(&m);
    assert_ok(
        sfem_mesh_parse_tetgen(node0, sizeof node0 - 1, ele0, sizeof ele0 - 1, NULL, &m, &err),
        err);
    assert_wanted(&m);
    assert_null(m.region);
    sfem_mesh_free(&m);
    free(node);
    free(ele);
}

static void text_need_not_end_in_a_newline_or_a_zero(void **state)
{
    size_t i;
    (void)state;
    for (i = 0; i < SAMPLES; ++i) {
        size_t n;
        char *text = sample(i, &n);
        char *exact = (char *)malloc(--n); /* the sanitizer sees a read beyond */
        sfem_error err;
        sfem_mesh m;
        memcpy(exact, text, n);
        assert_ok(sfem_mesh_parse(exact, n, NULL, &m, &err), err);
        assert_wanted(&m);
        sfem_mesh_free(&m);
        free(exact);
        free(text);
    }
}

static void physical_groups_become_regions(void **state)
{
    static const char head[] = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
                               "$Comments\nanything, $Nodes even\n$EndComments\n"
                               "$PhysicalNames\n1\n3 17 \"soft $tuff\"\n$EndPhysicalNames\n";
    static const char entities[] = "$Entities\n1 1 0 3\n1 0 0 0 0\n1 0 0 0 1 1 1 0 1 1\n"
                                   "4 0 0 0 1 1 1 1 -17 0\n5 0 0 0 1 1 1 2 18 19 1 1\n"
                                   "6 0 0 0 1 1 1 0 0\n$EndEntities\n";
    static const char nodes[] = "$Nodes\n1 4 1 4\n2 3 1 4\n1\n2\n3\n4\n0 0 0 .1 .2\n1 0 0 0 0\n"
                                "0 1 0 0 0\n0 0 1 0 0\n$EndNodes\n";
    static const char tets[] =
        "$Elements\n4 4 1 4\n3 5 4 1\n1 1 2 3 4\n3 4 4 1\n2 1 2 3 4\n"
        "3 6 4 1\n3 1 2 3 4\n3 99 4 1\n4 1 2 3 4\n$EndElements\n$Later\n1 2\n$EndLater\n";
    char text[1024];
    sfem_mesh m;
    (void)state;
    snprintf(text, sizeof text, "\xef\xbb\xbf%s%s%s%s", head, entities, nodes, tets);
    m = parse(text);
    assert_int_equal(m.region[0], 18); /* the first of two groups */
    assert_int_equal(m.region[1], 17); /* the sign only tells the orientation */
    assert_int_equal(m.region[2], 0);  /* in no group */
    assert_int_equal(m.region[3], 0);  /* not among the entities */
    sfem_mesh_free(&m);
    snprintf(text, sizeof text, "%s%s%s", head, nodes, tets); /* no $Entities: their numbers */
    m = parse(text);
    assert_int_equal(m.region[0], 5);
    assert_int_equal(m.region[1], 4);
    sfem_mesh_free(&m);
}

static void vtk_fields_and_data_are_passed_over(void **state)
{
    sfem_mesh m;
    (void)state;
    m = parse("# vtk DataFile Version 2.0\n\nascii\nFIELD FieldData 1\nTIME 1 1 double\n0.5\n"
              "DATASET UNSTRUCTURED_GRID\npoints 4 float\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
              "FIELD more 2\na 3 2 int\n1 2 3\n4 5 6\nb 1 1 int 4\n"
              "METADATA\nINFORMATION 1\nNAME x LOCATION y\n\n"
              "CELLS 2 7\n4 0 1 2 3\n1 2\nCELL_TYPES 2\n10 1\n"
              "POINT_DATA 4\nSCALARS s float\nnan nan");
    assert_int_equal(m.nodes, 4);
    assert_int_equal(m.tets, 1);
    sfem_mesh_free(&m);
}

/* A mesh with the given text as the x of its second node. */
static sfem_status parse_number(const char *number, sfem_real *x, sfem_error *err)
{
    char *text = (char *)malloc(strlen(number) + 400);
    sfem_status status;
    sfem_mesh m;
    sprintf(
        text,
        "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n0 0 0 "
        "%s 0 0 0 1 0 0 0 1\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n",
        number);
    status = sfem_mesh_parse(text, strlen(text), NULL, &m, err);
    if (status == SFEM_OK) {
        *x = m.x[3];
        sfem_mesh_free(&m);
    }
    free(text);
    return status;
}

static void numbers_are_read_to_the_nearest_double(void **state)
{
    static const struct {
        const char *text;
        sfem_real value;
    } number[] = {
        {"1", 1},
        {"-1.5e3", -1500},
        {"+.25", 0.25},
        {"7.", 7},
        {"1E-2", 0x1.47ae147ae147bp-7},
        {"0.1", 0x1.999999999999ap-4},
        {"0.3333333333333333148296162562473909929394721984863281250", 0x1.5555555555555p-2},
        {"9007199254740993", 9007199254740992.0}, /* a tie, to even */
        {"9007199254740993.00000000000000000000000001", 9007199254740994.0},
        {"9007199254740995", 9007199254740996.0},
        {"1.7976931348623157e308", 0x1.fffffffffffffp1023},
        {"1.797693134862315807e308", 0x1.fffffffffffffp1023},
        {"2.2250738585072011e-308", 0x0.fffffffffffffp-1022}, /* made some parsers loop */
        {"2.2250738585072014e-308", 0x1p-1022},
        {"4.9406564584124654e-324", 0x1p-1074},
        {"2.4703282292062328e-324", 0x1p-1074},
        {"2.4703282292062327e-324", 0}, /* below half of the smallest */
        {"1e-999999999999999999999999", 0},
        {"0e999999999999999999999999", 0},
        {"0.000000000000000000000000000000000000000000000000001e51", 1},
        {"123456789012345678901234567890e-29", 0x1.3c0ca428c59fbp0},
    };
    size_t i;
    sfem_error err;
    sfem_real x = 0;
    char longer[2000];
    (void)state;
    for (i = 0; i < TEST_COUNT(number); ++i) {
        assert_ok(parse_number(number[i].text, &x, &err), err);
        if (memcmp(&x, &number[i].value, sizeof x))
            fail_msg("%s gives %a, not %a", number[i].text, x, number[i].value);
    }
    /* 1 + 2^-53, a tie, then a digit far behind it */
    memset(longer, '0', sizeof longer);
    memcpy(longer, "1.00000000000000011102230246251565404236316680908203125", 55);
    strcpy(longer + 1500, "e0");
    assert_ok(parse_number(longer, &x, &err), err);
    assert_true(x == 1);
    longer[1499] = '1';
    assert_ok(parse_number(longer, &x, &err), err);
    assert_true(x == 0x1.0000000000001p0);
}

static void numbers_agree_with_the_c_library(void **state)
{
    test_random random = {99};
    int i;
    (void)state;
    for (i = 0; i < 20000; ++i) {
        uint64_t bits = random_bits(&random);
        sfem_real value, x = 0;
        char text[64];
        sfem_error err;
        memcpy(&value, &bits, sizeof value);
        if ((bits >> 52 & 0x7ff) == 0x7ff) continue;
        snprintf(text, sizeof text, "%.*e", (int)(random_bits(&random) % 25), value);
        value = strtod(text, NULL);
        if (fabs(value) > 1.7e308) continue;
        assert_ok(parse_number(text, &x, &err), err);
        if (memcmp(&x, &value, sizeof x)) fail_msg("%s gives %a, not %a", text, x, value);
    }
}

static void numbers_that_are_none_are_refused(void **state)
{
    static const char *const bad[] = {"abc", "1,5",  "1.2.3", "--1",   "e5", ".",       "1e",
                                      "1e+", "0x10", "1d5",   "1e5.0", "-",  "\x01\xff"};
    static const char *const infinite[] = {"nan",       "-NaN",  "inf",
                                           "+Infinity", "1e309", "-1e999999999999"};
    size_t i;
    sfem_error err;
    sfem_real x;
    (void)state;
    for (i = 0; i < TEST_COUNT(bad); ++i) {
        assert_status(parse_number(bad[i], &x, &err), SFEM_FORMAT);
        assert_int_equal(err.line, 6);
    }
    for (i = 0; i < TEST_COUNT(infinite); ++i) {
        assert_status(parse_number(infinite[i], &x, &err), SFEM_NOT_FINITE);
        assert_int_equal(err.line, 6);
    }
}

/* ---- refusing ---- */

typedef struct malformed {
    int line;         /* that is replaced .. */
    const char *text; /* .. by this, or NULL: the text ends before it */
    sfem_status status;
    sfem_int err_line;
    const char *words;
} malformed;

static void assert_refused(const char *const *lines, const malformed *table, size_t count)
{
    size_t i;
    for (i = 0; i < count; ++i) {
        const malformed *row = table + i;
        char *text = join(lines, row->line, row->text, "\n");
        test_memory memory = {0};
        sfem_allocator a = test_allocator(&memory);
        sfem_error err = {SFEM_OK, -1, -1, -1, ""};
        sfem_mesh m, before;
        sfem_status status;
        memset(&m, 0x5a, sizeof m);
        before = m;
        status = sfem_mesh_parse(text, strlen(text), &a, &m, &err);
        if (status != row->status || err.line != row->err_line || !strstr(err.text, row->words))
            fail_msg("line %d = '%s': status %d, line %d, \"%s\"; wanted %d, %d, \"%s\"", row->line,
                     row->text ? row->text : "(end)", status, err.line, err.text, row->status,
                     row->err_line, row->words);
        assert_memory_equal(&m, &before, sizeof m);
        assert_no_leak(memory);
        assert_true(memory.peak < 100000);
        free(text);
    }
}

static void malformed_gmsh_is_refused_with_its_line(void **state)
{
    static const malformed table[] = {
        {1, "$Meshformat2", SFEM_FORMAT, 1, "$MeshFormat"},
        {1, "", SFEM_FORMAT, 2, "only Gmsh 2.2 and 4.1, VTK legacy and .vtu, Medit, Abaqus .inp"},
        {2, "1 0 8", SFEM_FORMAT, 2, "Gmsh 1: only 2.0 to 2.2 and 4.1"},
        {2, "4 0 8", SFEM_FORMAT, 2, "Gmsh 4: only 2.0 to 2.2 and 4.1"},
        {2, "4.1 1 7", SFEM_FORMAT, 2, "the data size of a binary file is 7"},
        {2, "4.1 2 8", SFEM_FORMAT, 2, "the file type (0 ASCII, 1 binary) is 2"},
        {3, "$EndMeshFormat\n$MeshFormat", SFEM_FORMAT, 4, "a second $MeshFormat"},
        {2, "four", SFEM_FORMAT, 2, "expected a Gmsh version, found 'four'"},
        {2, "4.1 0", SFEM_FORMAT, 3, "data size"},
        {3, "$EndMesh", SFEM_FORMAT, 3, "expected $EndMeshFormat, found '$EndMesh'"},
        {3, NULL, SFEM_FORMAT, 3, "but the data ends"},
        {4, "Nodes", SFEM_FORMAT, 4, "expected a section"},
        {4, "$Node", SFEM_FORMAT, 29, "the end of the section"},
        {4, NULL, SFEM_FORMAT, 4, "ends before $Nodes"},
        {5, "2 99999999999 1 9", SFEM_FORMAT, 5, "more than the rest of the data can hold"},
        {5, "2 2000000000 1 9", SFEM_FORMAT, 5, "more than the rest of the data can hold"},
        {5, "2 -6 1 9", SFEM_FORMAT, 5, "the count of nodes is -6"},
        {5, "2 99999999999999999999 1 9", SFEM_FORMAT, 5, "too large a number"},
        {5, "2 5 1 9", SFEM_FORMAT, 11, "more than the 5 nodes announced"},
        {5, "2 7 1 9", SFEM_FORMAT, 20, "7 nodes announced, 6 found"},
        {5, "1 6 1 9", SFEM_FORMAT, 11, "expected $EndNodes"},
        {5, "3 6 1 9", SFEM_FORMAT, 20, "expected the dimension of an entity, found '$EndNodes'"},
        {6, "4 1 0 2", SFEM_FORMAT, 6, "the dimension of an entity is 4"},
        {6, "2 1 2 2", SFEM_FORMAT, 6, "parametric"},
        {6, "2 1 1 2", SFEM_FORMAT, 9, "expected a parametric coordinate, but the line ends"},
        {8, "90000000", SFEM_FORMAT, 8, "node tag 90000000 a second time"},
        {8, "0", SFEM_FORMAT, 8, "a node tag is 0"},
        {8, "7.5", SFEM_FORMAT, 8, "expected a node tag, found '7.5'"},
        {9, "0 0", SFEM_FORMAT, 9, "expected a coordinate, but the line ends"},
        {9, "0 0 0 0", SFEM_FORMAT, 9, "expected the end of the line, found '0'"},
        {10, "1 nan 0", SFEM_NOT_FINITE, 10, "a coordinate is not finite"},
        {17, "0 0 1e400", SFEM_NOT_FINITE, 17, "too large for a double"},
        {17, "0 zero 1", SFEM_FORMAT, 17, "found 'zero'"},
        {19, NULL, SFEM_FORMAT, 19, "but the data ends"},
        {20, "$EndElements", SFEM_FORMAT, 20, "expected $EndNodes"},
        {21, "$Nodes", SFEM_FORMAT, 21, "a second $Nodes"},
        {22, "2 4 1 3", SFEM_FORMAT, 28, "4 elements announced, 3 found"},
        {22, "2 18446744073709551616 1 3", SFEM_FORMAT, 22, "too large a number"},
        {25, "3 4 4 3", SFEM_FORMAT, 28, "expected another element, found '$EndElements'"},
        {25, "3 4 4 9000000000000000000", SFEM_FORMAT, 28, "expected another element"},
        {25, "3 4 11 2", SFEM_BAD_MESH, -1, "there are 2 tets of 10 nodes"},
        {26, "2 90000000 7 3", SFEM_FORMAT, 26, "expected a node tag of a tet, but the line ends"},
        {26, "2 90000000 7 3 2 1", SFEM_FORMAT, 26, "expected the end of the tet's line"},
        {27, "3 90000000 7 3 4", SFEM_BAD_MESH, 27, "tet 1 names node tag 4, which is not there"},
        {27, "3 90000000 7 3 -8", SFEM_BAD_MESH, 27, "tet 1 names node tag -8"},
        {27, NULL, SFEM_FORMAT, 27, "expected another element, but the data ends"},
        {28, NULL, SFEM_FORMAT, 28, "expected $EndElements, but the data ends"},
        {28, "$EndElements\n$Elements\n0 0 0 0\n$EndElements", SFEM_FORMAT, 29,
         "a second $Elements"},
        {28, "$EndElements\nrubbish", SFEM_FORMAT, 29, "expected a section like $Nodes"},
        {4, "$Elements\n0 0 0 0\n$EndElements\n$Nodes", SFEM_FORMAT, 4, "come before $Nodes"},
        {4, "$Entities\n0 0 0 1\n1 0 0 0 1 1\n$EndEntities", SFEM_FORMAT, 6,
         "a bound of the entity"},
        {4, "$Entities\n0 0 0 99\n", SFEM_FORMAT, 5, "can hold"},
        {4, "$Entities\n2 0 0 0\n1 0 0 0 0\n$EndEntities", SFEM_FORMAT, 7, "another entity"},
        {4, "$Entities\n0 0 0 2\n1 0 0 0 1 1 1 0 0\n1 0 0 0 1 1 1 0 0\n$EndEntities", SFEM_FORMAT,
         7, "volume 1 a second time"},
    };
    (void)state;
    assert_refused(gmsh_lines, table, TEST_COUNT(table));
}

static void malformed_vtk_is_refused_with_its_line(void **state)
{
    static const malformed table[] = {
        {1, "# vtk DataFile Version", SFEM_FORMAT, 1, "expected a VTK version"},
        {1, "# vtk DataFile Version 6.0", SFEM_FORMAT, 1, "VTK legacy 6.0: only 1.0 to 5.1"},
        {1, "# vtk DataFile", SFEM_FORMAT, 1, "this begins with '#'"},
        {1, "<VTKFile type=\"UnstructuredGrid\">", SFEM_FORMAT, 18, "there is no Piece"},
        {3, "BINARY", SFEM_FORMAT, -1, "byte 180: expected a coordinate, but the data ends"},
        {3, "asci", SFEM_FORMAT, 3, "expected ASCII or BINARY, found 'asci'"},
        {4, "DATASET POLYDATA", SFEM_FORMAT, 4, "expected UNSTRUCTURED_GRID, found 'POLYDATA'"},
        {4, "", SFEM_FORMAT, 5, "expected DATASET, found 'POINTS'"},
        {5, "POINTS 600000000 double", SFEM_FORMAT, 5, "more than the rest of the data can hold"},
        {5, "POINTS -1 double", SFEM_FORMAT, 5, "the count of points is -1"},
        {5, "POINTS 7 double", SFEM_FORMAT, 10, "expected a coordinate, found 'CELLS'"},
        {5, "POINTS 5 double", SFEM_FORMAT, 9, "expected POINTS, CELLS or CELL_TYPES, found '0'"},
        {5, "POINTS 6", SFEM_FORMAT, 9 + 1, "a coordinate"},
        {8, "5 inf 5", SFEM_NOT_FINITE, 8, "not finite"},
        {8, "5 5,0 5", SFEM_FORMAT, 8, "found '5,0'"},
        {9, "0 0 -1\nPOINTS 0 double", SFEM_FORMAT, 10, "POINTS a second time"},
        {10, "CELLS 3 1000", SFEM_FORMAT, 10, "can hold"},
        {10, "CELLS 2147483647 14", SFEM_FORMAT, 10, "can hold"},
        {10, "CELLS 2 14", SFEM_FORMAT, 14, "3 cell types for 2 cells"},
        {10, "CELLS 3 13", SFEM_FORMAT, 13, "found '5'"},
        {10, "CELLS 3 13 14", SFEM_FORMAT, 13, "expected POINTS"},
        {11, "4 0 1 2 6", SFEM_BAD_MESH, 11, "tet 0 names node 6, the mesh has 6"},
        {11, "4 0 1 2 -3", SFEM_BAD_MESH, 11, "tet 0 names node -3"},
        {11, "4 0 1 2 x", SFEM_FORMAT, 11, "expected a node of a tet, found 'x'"},
        {11, "3 0 1 2 3", SFEM_FORMAT, 11, "cell 0 of type 10 has 3 nodes, not 4"},
        {12, "-3 0 1 2", SFEM_FORMAT, 12, "the count of nodes of a cell is -3"},
        {12, "99999 0 1 2", SFEM_FORMAT, 12, "the count of nodes of a cell is 99999"},
        {14, "CELL_TYPES 2", SFEM_FORMAT, 14, "2 cell types for 3 cells"},
        {14, NULL, SFEM_FORMAT, 14, "there are no CELL_TYPES"},
        {10, NULL, SFEM_FORMAT, 10, "there are no CELLS"},
        {5, NULL, SFEM_FORMAT, 5, "there are no POINTS"},
        {13, NULL, SFEM_FORMAT, 10, "the count of numbers in CELLS is 14, more than the rest"},
        {13, "4 0 1 2", SFEM_FORMAT, 14, "expected POINTS, CELLS or CELL_TYPES, found '3'"},
        {15, "ten", SFEM_FORMAT, 15, "expected a cell type, found 'ten'"},
        {15, "12", SFEM_FORMAT, 11, "cell 0 of type 12 has 4 nodes, not 8"},
        {17, NULL, SFEM_FORMAT, 17, "expected a cell type, but the data ends"},
        {17, "1", SFEM_FORMAT, 13, "cell 2 of type 1 has 4 nodes, not 1"},
        {10, "CELLS 3 15\n4 0 1 2 3\n3 0 1 2\n4 0 1 2 5 9\nCELL_TYPES 3\n10 5 10\nPOINT_DATA 6",
         SFEM_FORMAT, 13, "CELLS have 1 numbers too many"},
        {10, "CELL_TYPES 0\nCELLS 3 14", SFEM_FORMAT, 10, "CELL_TYPES come before CELLS"},
        {10, "FIELD f 1\na 1000000 1000000 int 1\nCELLS 3 14", SFEM_FORMAT, 20, "another value"},
        {15, "4000000000", SFEM_FORMAT, 15, "a cell type is 4000000000"},
    };
    static const malformed table5[] = {
        {13, "1 4 7", SFEM_FORMAT, 13, "an offset is 1, not in 0 .. 0"},
        {13, "0 4 3", SFEM_FORMAT, 13, "an offset is 3, not in 4 .. 11"},
        {13, "0 4 12", SFEM_FORMAT, 13, "an offset is 12"},
        {14, "10", SFEM_FORMAT, 14, "the last offset is 10, not 11"},
        {14, "", SFEM_FORMAT, 15, "expected an offset, found 'CONNECTIVITY'"},
        {15, "CONNECTED vtktypeint64", SFEM_FORMAT, 15, "expected CONNECTIVITY"},
        {17, "0 1 2 9", SFEM_BAD_MESH, 17, "tet 1 names node 9, the mesh has 6"},
        {13, "0 3 7", SFEM_FORMAT, 16, "cell 0 of type 10 has 3 nodes, not 4"},
        {11, "CELLS 0 0", SFEM_FORMAT, 13, "expected CONNECTIVITY"},
    };
    (void)state;
    assert_refused(vtk_lines, table, TEST_COUNT(table));
    assert_refused(vtk5_lines, table5, TEST_COUNT(table5));
}

static void malformed_gmsh_2_is_refused_with_its_line(void **state)
{
    static const malformed table[] = {
        {2, "2.3 0 8", SFEM_FORMAT, 2, "Gmsh 2.3: only 2.0 to 2.2 and 4.1"},
        {9, "99999999999", SFEM_FORMAT, 9, "more than the rest of the data can hold"},
        {9, "5", SFEM_FORMAT, 15, "expected $EndNodes, found '8'"},
        {9, "7", SFEM_FORMAT, 16, "expected a node tag, found '$EndNodes'"},
        {10, "90000000 0 0", SFEM_FORMAT, 10, "expected a coordinate, but the line ends"},
        {11, "90000000 0 0 0", SFEM_FORMAT, 11, "node tag 90000000 a second time"},
        {11, "-7 1 0 0", SFEM_FORMAT, 11, "a node tag is -7"},
        {12, "3 0 inf 0", SFEM_NOT_FINITE, 12, "not finite"},
        {14, "1 5 5 5 5", SFEM_FORMAT, 14, "expected the end of the line, found '5'"},
        {18, "4", SFEM_FORMAT, 22, "expected an element tag, found '$EndElements'"},
        {18, "2", SFEM_FORMAT, 21, "expected $EndElements, found '3'"},
        {18, "-1", SFEM_FORMAT, 18, "the count of elements is -1"},
        {18, "9000000000000000000", SFEM_FORMAT, 22, "expected an element tag"},
        {20, "2 4 2 0 4 90000000 7 3", SFEM_FORMAT, 20,
         "expected a node tag of a tet, but the line"},
        {20, "2 4 2147483647 0 4 90000000 7 3", SFEM_FORMAT, 20, "expected a tag of an element"},
        {20, "2 4 2 0 4 90000000 7 3 2 1", SFEM_FORMAT, 20, "expected the end of the tet's line"},
        {20, "2 4 0 90000000 7 3 5", SFEM_BAD_MESH, 20,
         "tet 0 names node tag 5, which is not there"},
        {20, "2 11 0 90000000 7 3 5\n$EndElements", SFEM_FORMAT, 21, "expected an element tag"},
        {20, NULL, SFEM_FORMAT, 20, "but the data ends"},
    };
    (void)state;
    assert_refused(gmsh2_lines, table, TEST_COUNT(table));
}

static void malformed_veg_is_refused_with_its_line(void **state)
{
    static const malformed table[] = {
        {2, "*VERTICE", SFEM_FORMAT, 2,
         "expected *VERTICES, *ELEMENTS, *MATERIAL, *SET or *REGION"},
        {2, NULL, SFEM_FORMAT, 1, "this begins with '#'"},
        {2, "*VERTICES 6", SFEM_FORMAT, 2, "expected the end of the line, found '6'"},
        {3, "6 2 0 0", SFEM_FORMAT, 3, "nodes in 2 dimensions, not 3"},
        {3, "600000 3 0 0", SFEM_FORMAT, 3, "more than the rest of the data can hold"},
        {3, "5 3 0 0", SFEM_FORMAT, 9, "expected *VERTICES, *ELEMENTS"},
        {3, "7 3 0 0", SFEM_FORMAT, 10, "expected the number of a node, found '*ELEMENTS'"},
        {3, "6 3 1 0", SFEM_FORMAT, 4, "expected an attribute or marker, but the line ends"},
        {6, "2 0 1 0", SFEM_FORMAT, 6, "the number of a node is 2, not in 3 .. 3"},
        {6, "3 0 1", SFEM_FORMAT, 6, "expected a coordinate, but the line ends"},
        {6, "3 0 1 0 0", SFEM_FORMAT, 6, "expected the end of the node's line, found '0'"},
        {6, "3 0 1 NaN", SFEM_NOT_FINITE, 6, "not finite"},
        {6, "*INCLUDE /etc/passwd", SFEM_FORMAT, 6, "there is no file to include from"},
        {6, "*INCLUDE", SFEM_FORMAT, 6, "expected the name of a file, but the line ends"},
        {10, "*VERTICES", SFEM_FORMAT, 10, "*VERTICES a second time"},
        {10, NULL, SFEM_FORMAT, 10, "there are no *ELEMENTS"},
        {11, "CUBIC", SFEM_FORMAT, 11, "*ELEMENTS CUBIC: only TET is read"},
        {12, "2 8 0", SFEM_FORMAT, 12, "elements of 8 nodes, not 4"},
        {12, "0 4 0", SFEM_FORMAT, 13, "expected *VERTICES"},
        {12, "3 4 0", SFEM_FORMAT, 15, "expected the number of a tet, found '*MATERIAL'"},
        {12, "2 4 1", SFEM_FORMAT, 13, "expected the region of a tet, but the line ends"},
        {13, "1 0 2 3 4", SFEM_BAD_MESH, 13, "tet 0 names node 0, the nodes are 1 .. 6"},
        {14, "2 1 2 3 7", SFEM_BAD_MESH, 14, "tet 1 names node 7, the nodes are 1 .. 6"},
        {14, NULL, SFEM_FORMAT, 14, "expected the number of a tet, but the data ends"},
        {15, "*MATERIAL", SFEM_FORMAT, 15, "expected a name, but the line ends"},
        {16, NULL, SFEM_FORMAT, 16, "expected the law of a material, but the data ends"},
        {16, "", SFEM_FORMAT, 17, "expected the law of a material, found '*MATERIAL'"},
        {20, "3", SFEM_FORMAT, 20, "the number of a tet in a set is 3, not in 1 .. 2"},
        {20, "1 x", SFEM_FORMAT, 20, "expected the number of a tet in a set, found 'x'"},
        {22, "all, soft", SFEM_FORMAT, 22, "there is no *SET 'all' above"},
        {22, "allElements, sof", SFEM_FORMAT, 22, "there is no *MATERIAL 'sof' above"},
        {22, "allElements", SFEM_FORMAT, 22, "there is no *MATERIAL '' above"},
        {22, "allElements, soft, 3", SFEM_FORMAT, 22, "expected the end of the line, found '3'"},
        {22, NULL, SFEM_FORMAT, 22, "expected a set and a material, but the data ends"},
        {10, "*SET s", SFEM_FORMAT, 10, "*SET comes before *ELEMENTS"},
        {10, "*REGION", SFEM_FORMAT, 10, "*REGION comes before *ELEMENTS"},
        {2, "*ELEMENTS\nTET", SFEM_FORMAT, 3, "*ELEMENTS come before *VERTICES"},
    };
    (void)state;
    assert_refused(veg_lines, table, TEST_COUNT(table));
}

static void malformed_medit_is_refused_with_its_line(void **state)
{
    static const malformed table[] = {
        {2, "MeshVersionUnformatted 2", SFEM_FORMAT, 1, "this begins with '#'"},
        {2, "MeshVersionFormatted x", SFEM_FORMAT, 2, "expected the version of Medit's format"},
        {2, "MeshVersionFormatted 5", SFEM_FORMAT, 2, "format is 5, not in 1 .. 4"},
        {3, NULL, SFEM_FORMAT, 3, "there are no Vertices"},
        {3, "", SFEM_FORMAT, 4, "expected a keyword like Vertices, found '3'"},
        {4, "2", SFEM_FORMAT, 4, "vertices in 2 dimensions, not 3"},
        {4, "", SFEM_FORMAT, 5, "expected the dimension, found 'Vertices'"},
        {5, "Dimension 3\nVertex", SFEM_FORMAT, 22, "Tetrahedra come before Vertices"},
        {6, "-6", SFEM_FORMAT, 6, "the count of vertices is -6, not in 0"},
        {6, "600000", SFEM_FORMAT, 6, "more than the rest of the data can hold"},
        {6, "5", SFEM_FORMAT, 12, "expected a keyword like Vertices, found '0'"},
        {6, "7", SFEM_FORMAT, 13, "expected a coordinate, found 'Triangles'"},
        {8, "1d 0 0 0", SFEM_FORMAT, 8, "expected a coordinate, found '1d'"},
        {8, "1f0 0 0 0", SFEM_FORMAT, 8, "expected a coordinate, found '1f0'"},
        {8, "1d999 0 0 0", SFEM_NOT_FINITE, 8, "a coordinate is too large for a double"},
        {9, "0 1 nan 0", SFEM_NOT_FINITE, 9, "a coordinate is not finite"},
        {9, "0 1 0 0.5", SFEM_FORMAT, 9, "expected the reference of a vertex, found '0.5'"},
        {13, "Vertices 1", SFEM_FORMAT, 13, "Vertices a second time"},
        {13, "tetrahedra 1", SFEM_BAD_MESH, 14, "tet 0 names vertex 7"},
        {13, "Triangles 100000", SFEM_FORMAT, 13, "the count of Triangles is 100000, more than"},
        {13, "Triangles 0", SFEM_FORMAT, 14, "expected a keyword like Vertices, found '1'"},
        {16, "3", SFEM_FORMAT, 19, "expected another number of Normals, found 'NewInA"},
        {17, NULL, SFEM_FORMAT, 16, "the count of Normals is 2, more than the rest"},
        {18, NULL, SFEM_FORMAT, 16, "the count of Normals is 2, more than the rest"},
        {19, "Edges 2 11 12", SFEM_FORMAT, 21, "another number of Edges, found 'Tetrahedra'"},
        {21, NULL, SFEM_FORMAT, 21, "there are no Tetrahedra"},
        {22, "3", SFEM_FORMAT, 22, "the count of tets is 3, more than the rest of the data"},
        {23, "1 2 3 4", SFEM_FORMAT, 25, "expected the reference of a tet, found 'End'"},
        {22, "1", SFEM_FORMAT, 24, "expected a keyword like Vertices, found '1'"},
        {22, "0\nCorners 10", SFEM_BAD_MESH, -1, "there are 6 nodes and 1 triangles, but no 4-node tets"},
        {23, "1 2 3 0 4", SFEM_BAD_MESH, 23, "tet 0 names vertex 0, the vertices are 1 .. 6"},
        {24, "1 2 3 7 4", SFEM_BAD_MESH, 24, "tet 1 names vertex 7, the vertices are 1 .. 6"},
        {24, "1 2 3 6 9999999999", SFEM_FORMAT, 24, "the reference of a tet is 9999999999"},
    };
    (void)state;
    assert_refused(medit_lines, table, TEST_COUNT(table));
}

static void malformed_tetgen_is_refused_with_file_and_line(void **state)
{
    static const struct {
        int ele; /* the line is in the .ele */
        malformed row;
    } table[] = {
        {0, {1, NULL, SFEM_FORMAT, 1, "of .node: expected the count of nodes, but the data ends"}},
        {0, {2, "6 2 1 1", SFEM_FORMAT, 2, "nodes in 2 dimensions"}},
        {0, {2, "5 3 1 1", SFEM_FORMAT, 9, "line 9 of .node: expected the end of the file"}},
        {0, {2, "7 3 1 1", SFEM_FORMAT, 10, "expected the number of a node, but the data ends"}},
        {0, {2, "6 3 0 1", SFEM_FORMAT, 3, "expected the end of the node's line, found '1'"}},
        {0, {4, "3 1 0 0 .5 0", SFEM_FORMAT, 4, "the number of a node is 3, not in 2 .. 2"}},
        {0, {9, "6 0 0 1e999 0 0", SFEM_NOT_FINITE, 9, "too large for a double"}},
        {1, {1, "2 10 0", SFEM_FORMAT, 1, "line 1 of .ele: elements of 10 nodes, not 4"}},
        {1, {1, "2 4 0", SFEM_FORMAT, 2, "expected the end of the tet's line, found '4'"}},
        {1, {1, "0 4 0", SFEM_FORMAT, 2, "expected the end of the file"}},
        {1, {1, "9999999 4 0", SFEM_FORMAT, 1, "more than the rest of the data can hold"}},
        {1, {2, "1 1 2 3 0 4", SFEM_BAD_MESH, 2, "tet 0 names node 0, the nodes are 1 .. 6"}},
        {1, {2, "1 1 2 3 4 4.5", SFEM_FORMAT, 2, "the region 4.5 of a tet is not a whole number"}},
        {1, {2, "1 1 2 3 4 1e10", SFEM_FORMAT, 2, "not a whole number"}},
        {1, {3, "3 1 2 3 6 4", SFEM_FORMAT, 3, "the number of a tet is 3, not in 2 .. 2"}},
        {1, {3, NULL, SFEM_FORMAT, 3, "expected the number of a tet, but the data ends"}},
    };
    size_t i;
    (void)state;
    for (i = 0; i < TEST_COUNT(table); ++i) {
        const malformed *row = &table[i].row;
        char *node = join(node_lines, table[i].ele ? -1 : row->line, row->text, "\n");
        char *ele = join(ele_lines, table[i].ele ? row->line : -1, row->text, "\n");
        sfem_status status;
        sfem_error err;
        sfem_mesh m;
        status = sfem_mesh_parse_tetgen(node, strlen(node), ele, strlen(ele), NULL, &m, &err);
        if (status != row->status || err.line != row->err_line || !strstr(err.text, row->words))
            fail_msg("'%s': status %d, line %d, \"%s\"; wanted %d, %d, \"%s\"", row->text, status,
                     err.line, err.text, row->status, row->err_line, row->words);
        free(node);
        free(ele);
    }
}

/* The first place of bits in data that is not a text. */
static size_t find_bits(const char *data, size_t n, const void *bits, size_t count, int which)
{
    size_t i;
    for (i = 0; i + count <= n; ++i)
        if (!memcmp(data + i, bits, count) && !which--) return i;
    fail_msg("these bits are not there");
    return 0;
}

static void malformed_bytes_are_refused_with_their_place(void **state)
{
    static const struct {
        size_t which;       /* sample */
        const char *before; /* the text in front */
        int offset, value;  /* bytes behind it, and the int that is put there */
        sfem_status status;
        const char *words;
        int place; /* that is told, behind the int, or -1 */
    } table[] = {
        {TEXTS, "2.2 1 8\n", 0, 2, SFEM_FORMAT, "order of bytes is not 1", 4},
        {TEXTS, "$Nodes\n6\n", 0, 7, SFEM_FORMAT, "node tag 7 a second time", 32},
        {TEXTS, "$Nodes\n6\n", 0, -7, SFEM_FORMAT, "a node tag is -7", 0},
        {TEXTS, "$Nodes\n6\n", 8, 0x7ff00000, SFEM_NOT_FINITE, "coordinate is not finite", -1},
        {TEXTS, "$Elements\n3\n", 0, 77, SFEM_FORMAT, "elements of type 77, of unknown length", -1},
        {TEXTS, "$Elements\n3\n", 4, 4, SFEM_FORMAT, "the count of elements in a block is 4", -1},
        {TEXTS, "$Elements\n3\n", 8, 0x7fffffff, SFEM_FORMAT, "expected another element, but", -1},
        {TEXTS, "$Elements\n3\n", 36, 5, SFEM_FORMAT, "expected another element, but", -1},
        {TEXTS, "$Elements\n3\n", 60, 5, SFEM_BAD_MESH, "tet 0 names node tag 5", -1},
        {TEXTS + 2, "$Nodes\n6\n", 4, 0x7f800000, SFEM_NOT_FINITE, "a coordinate is not finite",
         -1},
        {TEXTS + 4, "$Nodes\n", 8, 0x7fffffff, SFEM_FORMAT, "more than the rest of the data can",
         -1},
        {TEXTS + 4, "$Nodes\n", 12, 1, SFEM_FORMAT, "more than the rest of the data can", -1},
        {TEXTS + 4, "$Nodes\n", 32, 4, SFEM_FORMAT, "the dimension of an entity is 4", -1},
        {TEXTS + 4, "$Nodes\n", 44, 7, SFEM_FORMAT, "more than the 6 nodes announced", -1},
        {TEXTS + 4, "$Elements\n", 32 + 12, -1, SFEM_FORMAT, "expected another element, but", -1},
        {TEXTS + 4, "$Elements\n", 32 + 16, -1, SFEM_FORMAT, "of elements in a block is -4294967",
         -1},
        {TEXTS + 4, "$Elements\n", 32 + 8, 99, SFEM_FORMAT, "elements of type 99", -1},
        {TEXTS + 4, "$Entities\n", 8, 0x7fffffff, SFEM_FORMAT, "more than the rest of the data",
         -1},
        {TEXTS + 4, "$Entities\n", 60, -1, SFEM_FORMAT, "a count of physical groups is 4294967295",
         -1},
    };
    size_t i, n;
    (void)state;
    for (i = 0; i < TEST_COUNT(table); ++i) {
        char *data = sample(table[i].which, &n), wanted[40];
        size_t at = find_bits(data, n, table[i].before, strlen(table[i].before), 0) +
                    strlen(table[i].before) + (size_t)table[i].offset;
        test_memory memory = {0};
        sfem_allocator a = test_allocator(&memory);
        sfem_error err = {SFEM_OK, -1, -1, -1, ""};
        sfem_status status;
        sfem_mesh m;
        int k;
        for (k = 0; k < 4; ++k) data[at + (size_t)k] = (char)(table[i].value >> 8 * k);
        status = sfem_mesh_parse(data, n, &a, &m, &err);
        if (status != table[i].status || !strstr(err.text, table[i].words) ||
            strncmp(err.text, "byte ", 5))
            fail_msg("row %d: status %d, \"%s\", wanted \"%s\"", (int)i, status, err.text,
                     table[i].words);
        if (table[i].place >= 0) {
            snprintf(wanted, sizeof wanted, "byte %d: ", (int)at + table[i].place);
            assert_memory_equal(err.text, wanted, strlen(wanted));
        }
        assert_no_leak(memory);
        free(data);
    }
}

static void other_data_is_refused(void **state)
{
    static const char tetgen[] = "4 3 0 0\n";
    unsigned char noise[256];
    sfem_error err;
    sfem_mesh m;
    int i;
    (void)state;
    for (i = 0; i < 256; ++i) noise[i] = (unsigned char)(255 - i);
    assert_status(sfem_mesh_parse(NULL, 0, NULL, &m, &err), SFEM_FORMAT);
    assert_names(err, "there is no data");
    assert_status(sfem_mesh_parse(" \n ", 3, NULL, &m, &err), SFEM_FORMAT);
    assert_status(sfem_mesh_parse(tetgen, sizeof tetgen - 1, NULL, &m, &err), SFEM_FORMAT);
    assert_names(err, "only");
    assert_status(sfem_mesh_parse(noise, sizeof noise, NULL, &m, &err), SFEM_FORMAT);
    for (i = 0; err.text[i]; ++i) assert_in_range(err.text[i], 32, 126);
    assert_status(sfem_mesh_parse("$", 1, NULL, &m, NULL), SFEM_FORMAT);
    assert_status(sfem_mesh_parse("\xef\xbb\xbf", 3, NULL, &m, NULL), SFEM_FORMAT);
}

static void a_text_cut_anywhere_is_refused(void **state)
{
    size_t i, n;
    (void)state;
    for (i = 0; i < SAMPLES; ++i) {
        size_t bytes;
        char *text = sample(i, &bytes);
        --bytes; /* without the last newline it is whole */
        if (i == 4) bytes = (size_t)(strstr(text, "*MATERIAL") - text - 1); /* as it is here */
        if (i == 5) bytes = (size_t)(strstr(text, "End") - text - 1);       /* likewise */
        for (n = 0; n < bytes; ++n) {
            char *cut = (char *)malloc(n ? n : 1);
            test_memory memory = {0};
            sfem_allocator a = test_allocator(&memory);
            sfem_error err = {SFEM_OK, -1, -1, -1, ""};
            sfem_mesh m;
            memcpy(cut, text, n);
            if (sfem_mesh_parse(cut, n, &a, &m, &err) == SFEM_OK)
                fail_msg("format %d cut after %d bytes is read", (int)i, (int)n);
            assert_true(err.text[0] && (err.line >= 1 || i >= TEXTS));
            assert_true(err.line >= 1 || strstr(err.text, "byte ") ||
                        strstr(err.text, "no 4-node"));
            assert_no_leak(memory);
            free(cut);
        }
        free(text);
    }
}

/* Bytes changed, lines doubled, lost and swapped: what comes through is a mesh with its nodes in
 * range, and no count in the text makes the memory large. */
static void damaged_texts_do_no_harm(void **state)
{
    static const char alphabet[] = "0123456789-+.eE \n$#nCELSx\xff";
    test_random random = {2024};
    int i, k, read = 0;
    (void)state;
    for (i = 0; i < 40000; ++i) {
        size_t n;
        char *text = sample((size_t)i % SAMPLES, &n), *copy;
        int changes = 1 + random_below(&random, 4);
        test_memory memory = {0};
        sfem_allocator a = test_allocator(&memory);
        sfem_error err = {SFEM_OK, -1, -1, -1, ""};
        sfem_mesh m;
        for (k = 0; k < changes; ++k) {
            size_t at = random_bits(&random) % n, length = 1 + random_bits(&random) % 12;
            if (length > n - at) length = n - at;
            switch (random_below(&random, 4)) {
            case 0:
                text[at] = alphabet[random_bits(&random) % (sizeof alphabet - 1)];
                break;
            case 1: /* bytes lost */
                if (n < 40) break;
                memmove(text + at, text + at + length, n - at - length);
                n -= length;
                break;
            case 2: /* bytes from elsewhere */
                memmove(text + at, text + random_bits(&random) % (n - length + 1), length);
                break;
            default:
                text[at] = (char)random_bits(&random);
                break;
            }
        }
        copy = (char *)malloc(n);
        memcpy(copy, text, n);
        if (sfem_mesh_parse(copy, n, &a, &m, &err) == SFEM_OK) {
            for (k = 0; k < 4 * m.tets; ++k) assert_in_range(m.tet[k], 0, m.nodes - 1);
            for (k = 0; k < 3 * m.nodes; ++k) assert_true(isfinite(m.x[k]));
            sfem_mesh_free(&m);
            ++read;
        } else
            assert_true(err.text[0] != 0);
        assert_no_leak(memory);
        assert_true(memory.peak < 64 * n + 8192);
        free(copy);
        free(text);
    }
    assert_true(read > 300); /* some damage changes a coordinate only */
}

static void files_of_tetgen_cut_anywhere_are_refused(void **state)
{
    char *node = join(node_lines, -1, NULL, "\n"), *ele = join(ele_lines, -1, NULL, "\n");
    const size_t nodes = strlen(node) - 1, tets = (size_t)(strchr(ele, '#') - ele) - 1;
    size_t n;
    (void)state;
    for (n = 0; n < nodes + tets; ++n) {
        const size_t a = n < nodes ? n : nodes, b = n < nodes ? tets : n - nodes;
        char *node_cut = (char *)malloc(a + 1), *ele_cut = (char *)malloc(b + 1);
        test_memory memory = {0};
        sfem_allocator allocator = test_allocator(&memory);
        sfem_error err;
        sfem_mesh m;
        memcpy(node_cut + 1, node, a); /* it ends where the sanitizer looks */
        memcpy(ele_cut + 1, ele, b);
        if (sfem_mesh_parse_tetgen(node_cut + 1, a, ele_cut + 1, b, &allocator, &m, &err) ==
            SFEM_OK)
            fail_msg("%d and %d bytes are read", (int)a, (int)b);
        assert_true(err.line >= 1);
        assert_no_leak(memory);
        free(node_cut);
        free(ele_cut);
    }
    free(node);
    free(ele);
}

/* ---- regions and names ---- */

static void physical_groups_of_gmsh_2_become_regions(void **state)
{
    char *text = join(gmsh2_lines, 21, "3 4 2 -5 4 90000000 7 3 8", "\n");
    sfem_mesh m;
    (void)state;
    m = parse(text);
    assert_int_equal(m.region[0], 0); /* in none, while others are in one */
    assert_int_equal(m.region[1], 5);
    sfem_mesh_free(&m);
    free(text);
}

static void materials_of_vega_become_regions(void **state)
{
    sfem_mesh m;
    char *text;
    (void)state;
    text = join(veg_lines, 21, NULL, "\n"); /* no *REGION */
    m = parse(text);
    assert_null(m.region);
    sfem_mesh_free(&m);
    free(text);
    text = join(veg_lines, 22, "one, soft\n*REGION\none, very hard\n*SET two\n1 2\n2 1", "\n");
    m = parse(text); /* the later one wins, and tet 0 is in none */
    assert_int_equal(m.region[0], -1);
    assert_int_equal(m.region[1], 1);
    sfem_mesh_free(&m);
    free(text);
    m = parse("*VERTICES\n4 3\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n*ELEMENTS\nTETS\n2 4\n"
              "0 0 1 2 3\n1 0 1 2 3\n*SET first\n0\n*MATERIAL a b\nMOONEYRIVLIN, 1, 2, 3, 4\n"
              "*REGION\n first , a b\n");
    assert_int_equal(m.region[0], 0); /* numbers from 0 */
    assert_int_equal(m.region[1], -1);
    sfem_mesh_free(&m);
}

/* As many sets, materials and regions as tets, and a set of all tets that as many regions name: looking each
 * name up among all others, or filling in each region at once, would take minutes. */
static void many_names_of_vega_cost_no_more_than_their_bytes(void **state)
{
    enum { N = 300000 };
    char *text = (char *)malloc(150 * (size_t)N), *p = text;
    sfem_mesh m;
    sfem_error err;
    sfem_int i;
    (void)state;
    assert_non_null(text);
    p += sprintf(p, "*VERTICES\n4 3\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n*ELEMENTS\nTET\n%d 4\n", N);
    for (i = 0; i < N; ++i) p += sprintf(p, "%d 0 1 2 3\n", (int)i);
    for (i = 0; i < N; ++i) p += sprintf(p, "*MATERIAL m%d\nENU\n", (int)i);
    p += sprintf(p, "*SET all\n");
    for (i = 0; i < N; ++i) p += sprintf(p, "%d\n", (int)i);
    for (i = 0; i < N; ++i) p += sprintf(p, "*SET s%d\n%d\n", (int)i, (int)i);
    for (i = 0; i < N; ++i) p += sprintf(p, "*REGION\n%s,m%d\n", i % 2 ? "all" : "allElements", (int)i);
    for (i = 0; i < N; i += 3) p += sprintf(p, "*REGION\ns%d,m%d\n", (int)i, (int)(N - 1 - i));
    p += sprintf(p, "*SET s0\n1\n*REGION\ns0,m7\n"); /* the set that came first has the name */
    assert_ok(sfem_mesh_parse(text, (size_t)(p - text), NULL, &m, &err), err);
    assert_int_equal(m.region[0], 7);
    for (i = 1; i < N; ++i) assert_int_equal(m.region[i], i % 3 ? N - 1 : N - 1 - i);
    sfem_mesh_free(&m);
    free(text);
}

/* Names of which one begins another, or that differ by a byte of any value. */
static void names_of_vega_are_told_apart(void **state)
{
    static const char head[] = "*VERTICES\n4 3\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n*ELEMENTS\nTET\n1 4\n0 0 1 2 3\n";
    test_random random = {3};
    int round;
    (void)state;
    for (round = 0; round < 400; ++round) {
        char text[4000], name[24][8], *p = text;
        int length[24], count = 1 + (int)random_below(&random, 24), i, k, wanted;
        sfem_mesh m;
        sfem_error err;
        memcpy(p, head, sizeof head - 1);
        p += sizeof head - 1;
        for (i = 0; i < count; ++i) {
            length[i] = 1 + (int)random_below(&random, 4);
            for (k = 0; k < length[i]; ++k) name[i][k] = "\001\200ab\377"[random_below(&random, 5)];
            p += sprintf(p, "*MATERIAL ");
            memcpy(p, name[i], (size_t)length[i]);
            p += length[i];
            p += sprintf(p, "\nENU\n");
        }
        i = (int)random_below(&random, count);
        for (wanted = 0; length[wanted] != length[i] || memcmp(name[wanted], name[i], (size_t)length[i]) != 0;)
            ++wanted;
        p += sprintf(p, "*REGION\nallElements, ");
        memcpy(p, name[i], (size_t)length[i]);
        p += length[i];
        *p++ = '\n';
        assert_ok(sfem_mesh_parse(text, (size_t)(p - text), NULL, &m, &err), err);
        assert_int_equal(m.region[0], wanted);
        sfem_mesh_free(&m);
        p[-2 - (round % 2)] ^= 16; /* mostly no name any more */
        {
            const sfem_status status = sfem_mesh_parse(text, (size_t)(p - text), NULL, &m, &err);
            assert_true(status == SFEM_OK || status == SFEM_FORMAT);
            if (status == SFEM_OK) sfem_mesh_free(&m);
        }
    }
}

static void either_file_of_tetgen_names_both(void **state)
{
    static const char *const name[4] = {"test_meshio_pair.node", "test_meshio_pair.ele",
                                        "test_meshio_PAIR.NODE", "test_meshio_PAIR.ELE"};
    const char *const texts[2] = {
        "6 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n4 5 5 5\n5 0 0 -1\n",
        "2 4 1\n0 0 1 2 3 7\n1 0 1 2 5 8\n"};
    sfem_error err;
    sfem_mesh m;
    int i;
    (void)state;
    for (i = 0; i < 4; ++i) scratch_write(scratch_path(name[i]), texts[i % 2]);
    for (i = 0; i < 4; ++i) {
        assert_ok(sfem_mesh_read(scratch_path(name[i]), NULL, &m, &err), err);
        assert_wanted(&m);
        assert_int_equal(m.region[0], 7);
        assert_int_equal(m.region[1], 8);
        sfem_mesh_free(&m);
    }
    scratch_write(scratch_path(name[1]), "2 4 1\n0 0 1 2 3 7\n1 0 1 2 x 8\n");
    assert_status(sfem_mesh_read(scratch_path(name[0]), NULL, &m, &err), SFEM_FORMAT);
    assert_names(err, "test_meshio_pair.node: line 3 of .ele: expected a node of a tet, found 'x'");
    assert_int_equal(err.line, 3);
    remove(scratch_path(name[1]));
    assert_status(sfem_mesh_read(scratch_path(name[0]), NULL, &m, &err), SFEM_IO);
    assert_names(err, "test_meshio_pair.ele: cannot be opened");
    for (i = 0; i < 4; ++i) remove(scratch_path(name[i]));
}

static const char veg_with_parts[] = "*VERTICES\n*INCLUDE test_meshio_part.node\n*ELEMENTS\nTET\n"
                                     "*include test_meshio_part.ele\n*MATERIAL a\nENU, 1, 1, 0\n"
                                     "*SET s\n1\n*INCLUDE test_meshio_part.set\n*REGION\ns, a\n";

static void write_parts(const char *set)
{
    char *node = join(node_lines, -1, NULL, "\n");
    scratch_write(scratch_path("test_meshio.veg"), veg_with_parts);
    scratch_write(scratch_path("test_meshio_part.node"), node);
    scratch_write(scratch_path("test_meshio_part.ele"), "2 4\n1 1 2 3 4\n2 1 2 3 6");
    scratch_write(scratch_path("test_meshio_part.set"), set);
    free(node);
}

static void vega_includes_files_beside_it(void **state)
{
    static const struct {
        const char *set;
        sfem_status status;
        const char *words;
    } bad[] = {
        {"1\n3", SFEM_FORMAT,
         "test_meshio.veg: line 2 of test_meshio_part.set: the number of a tet"},
        {"\n*INCLUDE test_meshio_part.set", SFEM_TOO_LARGE, "more than 16 files are included"},
        {"*INCLUDE none.veg", SFEM_IO, "none.veg: cannot be opened"},
        {"*INCLUDE /etc/passwd", SFEM_FORMAT, "*INCLUDE /etc/passwd: not a file beside this one"},
        {"*INCLUDE ../x", SFEM_FORMAT, "*INCLUDE ../x: not a file beside this one"},
        {"*INCLUDE a\\x", SFEM_FORMAT, "*INCLUDE a\\x: not a file beside this one"},
    };
    const char *path;
    sfem_error err;
    sfem_mesh m;
    size_t i;
    (void)state;
    write_parts("2");
    path = scratch_path("test_meshio.veg");
    assert_ok(sfem_mesh_read(path, NULL, &m, &err), err);
    assert_wanted(&m);
    assert_int_equal(m.region[0], 0);
    assert_int_equal(m.region[1], 0);
    sfem_mesh_free(&m);
    for (i = 0; i < TEST_COUNT(bad); ++i) {
        write_parts(bad[i].set);
        path = scratch_path("test_meshio.veg");
        assert_status(sfem_mesh_read(path, NULL, &m, &err), bad[i].status);
        assert_names(err, bad[i].words);
    }
    remove(scratch_path("test_meshio.veg"));
    remove(scratch_path("test_meshio_part.node"));
    remove(scratch_path("test_meshio_part.ele"));
    remove(scratch_path("test_meshio_part.set"));
}

/* ---- writing ---- */

static sfem_mesh test_ball(void)
{
    sfem_error err;
    sfem_mesh m;
    sfem_int t;
    assert_ok(sfem_mesh_ball(0.1, 3, NULL, &m, &err), err);
    m.region = (sfem_int *)malloc((size_t)m.tets * sizeof *m.region);
    for (t = 0; t < m.tets; ++t) m.region[t] = t / 7 % 5 - 1;
    return m;
}

static void free_ball(sfem_mesh *m)
{
    free(m->region);
    m->region = NULL;
    sfem_mesh_free(m);
}

static char *contents(const char *path, size_t *bytes)
{
    FILE *f = fopen(path, "rb");
    char *text = (char *)malloc(1 << 20);
    assert_non_null(f);
    *bytes = fread(text, 1, (1 << 20) - 1, f);
    text[*bytes] = 0;
    fclose(f);
    return text;
}

static void assert_round_trip(void)
{
    const char *path = scratch_path("test_meshio.msh");
    sfem_mesh m = test_ball(), back;
    sfem_error err;
    m.x[0] = -0.0;
    m.x[1] = 1e-310;
    m.x[2] = -1.2345678901234567e-7;
    assert_ok(sfem_mesh_write_msh(path, &m, &err), err);
    assert_ok(sfem_mesh_read(path, NULL, &back, &err), err);
    assert_int_equal(back.nodes, m.nodes);
    assert_int_equal(back.tets, m.tets);
    assert_memory_equal(back.x, m.x, 3 * (size_t)m.nodes * sizeof *m.x);
    assert_memory_equal(back.tet, m.tet, 4 * (size_t)m.tets * sizeof *m.tet);
    assert_memory_equal(back.region, m.region, (size_t)m.tets * sizeof *m.region);
    sfem_mesh_free(&back);
    free_ball(&m);
    remove(path);
}

static void a_mesh_comes_back_as_it_was_written(void **state)
{
    (void)state;
    assert_round_trip();
}

static void the_locale_changes_nothing(void **state)
{
    static const char *const names[] = {"de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8", "fr_FR.utf8",
                                        "de_DE",       "fr_FR",      "ps_AF.UTF-8"};
    const char *path = scratch_path("test_meshio.obj");
    char *text;
    size_t i, bytes;
    sfem_mesh m;
    for (i = 0; i < TEST_COUNT(names); ++i)
        if (setlocale(LC_ALL, names[i])) break;
    if (i == TEST_COUNT(names)) skip(); /* no locale with a decimal comma is installed */
    assert_true(localeconv()->decimal_point[0] != '.');
    assert_round_trip();
    the_same_mesh_comes_from_each_format(state);
    m = test_ball();
    assert_status(sfem_mesh_write_obj(path, &m, NULL, NULL, NULL), SFEM_OK);
    text = contents(path, &bytes);
    assert_null(strchr(text, ','));
    free(text);
    free_ball(&m);
    remove(path);
    setlocale(LC_ALL, "C");
}

/* The appended array of a name, found as a reader of the format does. */
static const char *vtu_array(const char *text, const char *name, const char *type, int components,
                             uint64_t *bytes)
{
    char wanted[128];
    const char *at, *data = strstr(text, "<AppendedData encoding=\"raw\">\n_");
    unsigned long offset;
    snprintf(wanted, sizeof wanted,
             "<DataArray type=\"%s\" Name=\"%s\" NumberOfComponents=\"%d\" format=\"appended\" "
             "offset=\"",
             type, name, components);
    at = strstr(text, wanted);
    if (!at || !data) fail_msg("no array %s", name);
    offset = strtoul(at + strlen(wanted), NULL, 10);
    data = strchr(data, '_') + 1 + offset;
    memcpy(bytes, data, 8);
    return data + 8;
}

static void vtu_holds_positions_cells_and_fields(void **state)
{
    const char *path = scratch_path("test_meshio.vtu");
    sfem_mesh m = test_ball();
    sfem_real *x = (sfem_real *)malloc(3 * (size_t)m.nodes * sizeof *x);
    sfem_real *heat = (sfem_real *)malloc((size_t)m.tets * sizeof *heat);
    sfem_field field[2];
    sfem_error err;
    uint64_t n;
    size_t bytes;
    char *text, wanted[80];
    const char *data;
    sfem_int i;
    (void)state;
    for (i = 0; i < 3 * m.nodes; ++i) x[i] = 2 * m.x[i];
    for (i = 0; i < m.tets; ++i) heat[i] = sqrt(i);
    memset(field, 0, sizeof field);
    field[0].name = "a<b&\"c\"", field[0].values = heat;
    field[0].components = 1, field[0].per_tet = 1;
    field[1].name = "u", field[1].values = m.x, field[1].components = 3;
    assert_ok(sfem_mesh_write_vtu(path, &m, x, field, 2, &err), err);
    text = contents(path, &bytes);
    snprintf(wanted, sizeof wanted, "<Piece NumberOfPoints=\"%d\" NumberOfCells=\"%d\">", m.nodes,
             m.tets);
    assert_non_null(strstr(text, wanted));
    data = vtu_array(text, "Points", "Float64", 3, &n);
    assert_int_equal(n, 24 * m.nodes);
    assert_memory_equal(data, x, n);
    data = vtu_array(text, "connectivity", "Int32", 1, &n);
    assert_int_equal(n, 16 * m.tets);
    assert_memory_equal(data, m.tet, n);
    data = vtu_array(text, "offsets", "Int64", 1, &n);
    assert_int_equal(n, 8 * m.tets);
    for (i = 0; i < m.tets; ++i) {
        int64_t end;
        memcpy(&end, data + 8 * i, 8);
        assert_int_equal(end, 4 * (i + 1));
    }
    data = vtu_array(text, "types", "UInt8", 1, &n);
    assert_int_equal(n, m.tets);
    for (i = 0; i < m.tets; ++i) assert_int_equal(data[i], 10);
    data = vtu_array(text, "u", "Float64", 3, &n);
    assert_int_equal(n, 24 * m.nodes);
    assert_memory_equal(data, m.x, n);
    data = vtu_array(text, "a&lt;b&amp;&quot;c&quot;", "Float64", 1, &n);
    assert_int_equal(n, 8 * m.tets);
    assert_memory_equal(data, heat, n);
    data = vtu_array(text, "region", "Int32", 1, &n);
    assert_int_equal(n, 4 * m.tets);
    assert_memory_equal(data, m.region, n);
    assert_string_equal(data + n, "\n</AppendedData>\n</VTKFile>\n"); /* the last array */
    field[1].components = 0;
    assert_status(sfem_mesh_write_vtu(path, &m, x, field, 2, &err), SFEM_BAD_ARGUMENT);
    assert_names(err, "field 1");
    assert_ok(sfem_mesh_write_vtu(path, &m, NULL, NULL, 0, &err), err);
    free(text);
    free(x);
    free(heat);
    free_ball(&m);
    remove(path);
}

static void pvd_lists_files_and_times(void **state)
{
    const char *path = scratch_path("test_meshio.pvd");
    const char *const files[2] = {"a_0.vtu", "a&b.vtu"};
    const sfem_real times[2] = {0, 0.1}, never[2] = {0, NAN};
    sfem_error err;
    size_t bytes;
    char *text;
    (void)state;
    assert_ok(sfem_mesh_write_pvd(path, files, times, 2, &err), err);
    text = contents(path, &bytes);
    assert_string_equal(text,
                        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\">\n"
                        "<Collection>\n<DataSet timestep=\"0\" part=\"0\" file=\"a_0.vtu\"/>\n"
                        "<DataSet timestep=\"0.1\" part=\"0\" file=\"a&amp;b.vtu\"/>\n"
                        "</Collection>\n</VTKFile>\n");
    free(text);
    assert_status(sfem_mesh_write_pvd(path, files, never, 2, &err), SFEM_BAD_ARGUMENT);
    remove(path);
}

static void obj_holds_the_surface_at_the_given_positions(void **state)
{
    const char *path = scratch_path("test_meshio.obj");
    /* a tet on nodes 1 2 4 5; 0 and 3 are not on the surface and not in the file */
    sfem_real x[18] = {9, 9, 9, 0, 0, 0, 1, 0, 0, 9, 9, 9, 0, 1, 0, 0, 0, 1}, moved[18];
    sfem_int tet[4] = {1, 2, 4, 5}, i;
    sfem_mesh m;
    sfem_surface s;
    sfem_error err;
    size_t bytes;
    char *text;
    (void)state;
    memset(&m, 0, sizeof m);
    m.nodes = 6, m.tets = 1, m.x = x, m.tet = tet;
    for (i = 0; i < 18; ++i) moved[i] = x[i] / 10;
    assert_ok(sfem_mesh_write_obj(path, &m, NULL, moved, &err), err);
    text = contents(path, &bytes);
    assert_string_equal(text, "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\n"
                              "f 2 3 4\nf 1 4 3\nf 1 2 4\nf 1 3 2\n");
    free(text);
    assert_ok(sfem_mesh_surface(&m, NULL, &s, &err), err);
    s.triangles = 1;
    assert_ok(sfem_mesh_write_obj(path, &m, &s, NULL, &err), err);
    text = contents(path, &bytes);
    assert_string_equal(text, "v 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n");
    free(text);
    sfem_surface_free(&s);
    remove(path);
}

static void files_that_cannot_be_used_are_reported(void **state)
{
    const char *const missing = "/nonexistent directory/x.msh";
    const char *const files[1] = {"a"};
    const sfem_real times[1] = {0};
    sfem_mesh m = test_ball(), out;
    sfem_error err;
    (void)state;
    assert_status(sfem_mesh_read(missing, NULL, &out, &err), SFEM_IO);
    assert_names(err, "/nonexistent directory/x.msh: cannot be opened (No such file");
    assert_status(sfem_mesh_read(".", NULL, &out, &err), SFEM_IO);
    assert_status(sfem_mesh_write_msh(missing, &m, &err), SFEM_IO);
    assert_names(err, "cannot be opened for writing");
    assert_status(sfem_mesh_write_vtu(missing, &m, NULL, NULL, 0, &err), SFEM_IO);
    assert_status(sfem_mesh_write_pvd(missing, files, times, 1, &err), SFEM_IO);
    assert_status(sfem_mesh_write_obj(missing, &m, NULL, NULL, &err), SFEM_IO);
    if (access("/dev/full", W_OK) == 0) { /* a disk without room */
        assert_status(sfem_mesh_write_msh("/dev/full", &m, &err), SFEM_IO);
        assert_names(err, "cannot be written (No space");
        assert_status(sfem_mesh_write_vtu("/dev/full", &m, NULL, NULL, 0, &err), SFEM_IO);
        assert_status(sfem_mesh_write_pvd("/dev/full", files, times, 1, &err), SFEM_IO);
        assert_status(sfem_mesh_write_obj("/dev/full", &m, NULL, NULL, &err), SFEM_IO);
    }
    free_ball(&m);
}

static void a_surface_of_another_mesh_is_not_written(void **state)
{
    const char *path = scratch_path("test_meshio_other.obj");
    sfem_int tri[2][3] = {{0, 1, 2}, {0, 1, -1}};
    sfem_surface surface;
    sfem_mesh m = test_ball();
    sfem_error err;
    (void)state;
    memset(&surface, 0, sizeof surface);
    surface.triangles = 2;
    surface.tri = tri[0];
    remove(path);
    assert_status(sfem_mesh_write_obj(path, &m, &surface, NULL, &err), SFEM_BAD_MESH);
    assert_names(err, "triangle 1 of the surface names node -1, the mesh has");
    tri[1][2] = m.nodes;
    assert_status(sfem_mesh_write_obj(path, &m, &surface, NULL, &err), SFEM_BAD_MESH);
    assert_int_not_equal(access(path, F_OK), 0);
    free_ball(&m);
}

static void a_mesh_of_negative_counts_is_not_written(void **state)
{
    const char *path = scratch_path("test_meshio_negative");
    sfem_surface surface;
    sfem_mesh m;
    sfem_error err;
    int k;
    (void)state;
    memset(&surface, 0, sizeof surface);
    remove(path);
    for (k = 0; k < 2; ++k) {
        memset(&m, 0, sizeof m);
        *(k ? &m.tets : &m.nodes) = -3;
        assert_status(sfem_mesh_write_msh(path, &m, &err), SFEM_BAD_MESH);
        assert_names(err, k ? "0 nodes and -3 tets" : "-3 nodes and 0 tets");
        assert_status(sfem_mesh_write_vtu(path, &m, NULL, NULL, 0, &err), SFEM_BAD_MESH);
        assert_names(err, k ? "0 nodes and -3 tets" : "-3 nodes and 0 tets");
        assert_status(sfem_mesh_write_obj(path, &m, NULL, NULL, &err), SFEM_BAD_MESH);
        assert_status(sfem_mesh_write_obj(path, &m, &surface, NULL, &err), SFEM_BAD_MESH);
        assert_int_not_equal(access(path, F_OK), 0);
    }
}

static void a_file_with_a_fault_is_named_with_the_line(void **state)
{
    const char *path = scratch_path("test_meshio_bad.msh");
    char *text = join(gmsh_lines, 17, "0 zero 1", "\n"), wanted[1200];
    sfem_error err;
    sfem_mesh m;
    (void)state;
    scratch_write(path, text);
    assert_status(sfem_mesh_read(path, NULL, &m, &err), SFEM_FORMAT);
    assert_int_equal(err.line, 17);
    snprintf(wanted, sizeof wanted, "%.100s: line 17: expected a coordinate, found 'zero'", path);
    assert_string_equal(err.text, wanted);
    remove(path);
    free(text);
}

/* ---- memory ---- */

static sfem_status do_each(sfem_allocator allocator, void *user, sfem_error *err)
{
    const int which = *(const int *)user;
    sfem_status status;
    sfem_mesh m;
    if (which < SAMPLES) {
        size_t n;
        char *data = sample((size_t)which, &n);
        status = sfem_mesh_parse(data, n, &allocator, &m, err);
        free(data);
    } else if (which == SAMPLES + 2) {
        status = sfem_mesh_read(scratch_path("test_meshio.veg"), &allocator, &m, err);
    } else if (which == SAMPLES + 3) {
        status = sfem_mesh_read(scratch_path("test_meshio_part.node"), &allocator, &m, err);
    } else if (which == SAMPLES) {
        status = sfem_mesh_read(scratch_path("test_meshio_memory.msh"), &allocator, &m, err);
    } else {
        m = test_ball();
        m.allocator = allocator;
        status = sfem_mesh_write_obj(scratch_path("test_meshio_memory.obj"), &m, NULL, NULL, err);
        memset(&m.allocator, 0, sizeof m.allocator);
        free_ball(&m);
        return status;
    }
    if (status == SFEM_OK) sfem_mesh_free(&m);
    return status;
}

static void every_allocation_may_fail(void **state)
{
    sfem_error err;
    sfem_mesh m;
    int which;
    (void)state;
    assert_ok(sfem_mesh_ball(1, 12, NULL, &m, &err), err); /* its file outgrows the first buffer */
    assert_ok(sfem_mesh_write_msh(scratch_path("test_meshio_memory.msh"), &m, &err), err);
    sfem_mesh_free(&m);
    write_parts("2");
    for (which = 0; which < SAMPLES + 4; ++which)
        assert_true(fail_every_allocation(do_each, &which) >= 3);
    remove(scratch_path("test_meshio.veg"));
    remove(scratch_path("test_meshio_part.node"));
    remove(scratch_path("test_meshio_part.ele"));
    remove(scratch_path("test_meshio_part.set"));
    remove(scratch_path("test_meshio_memory.msh"));
    remove(scratch_path("test_meshio_memory.obj"));
}

/* ---- meshes that others made ---- */

static void real_meshes_are_read(void **state)
{
    static const struct {
        const char *name;
        sfem_int nodes, tets, euler;
    } real[] = {{"mj_cube_41_ascii.msh", 14, 24, 2},
                {"mj_cube_41_binary.msh", 14, 24, 2},
                {"mj_shark_ascii22.msh", 425, 1070, 1},
                {"mj_shark_binary22.msh", 429, 1073, 1},
                {"vega_beam3.veg", 208, 450, 2},
                {"vega_comb.veg", 1623, 5844, 2},
                {"vega_simpleBridge.veg", 4000, 12827, -50},
                {"vega_helix.veg", 4532, 16226, 0},
                {"bullet_torus.vtk", 1036, 4436, 0},
                {"igl_octopus_low.mesh", 452, 1140, 2},
                {"ipc_rod300x33.msh", 13333, 50511, 2},
                {"vega_yeahright.veg", 21122, 71577, -363}};
    sfem_real shark = 0;
    size_t i, found = 0;
    (void)state;
    for (i = 0; i < TEST_COUNT(real); ++i) {
        const char *path = mesh_path(real[i].name);
        sfem_mesh m;
        sfem_mesh_report r;
        sfem_error err;
        if (!path) continue;
        ++found;
        assert_ok(sfem_mesh_read(path, NULL, &m, &err), err);
        assert_int_equal(m.nodes, real[i].nodes);
        assert_int_equal(m.tets, real[i].tets);
        assert_ok(sfem_mesh_check(&m, &r, &err), err);
        assert_int_equal(r.euler, real[i].euler);
        assert_int_equal(r.components, 1);
        assert_int_equal(r.unused + r.overlapping + r.coincident, 0);
        if (i < 2) assert_near(r.volume, 1, 1e-14, 0); /* a cube of side 1 */
        if (i == 2) shark = r.volume;
        if (i == 3) assert_near(r.volume, shark, 1e-3, 0); /* meshed anew */
        if (i == 4) assert_near(r.volume, .12 * .04 * 1, 1e-12, 0);
        if (strstr(path, ".veg")) assert_int_equal(m.region[m.tets - 1], 0);
        if (m.nodes > 1000 && m.nodes != 1623) { /* the comb is well numbered as it is */
            sfem_int before = mesh_bandwidth(&m);
            sfem_real volume = r.volume;
            assert_ok(sfem_mesh_renumber(&m, NULL, &err), err);
            assert_true(8 * mesh_bandwidth(&m) < before);
            assert_ok(sfem_mesh_check(&m, &r, &err), err);
            assert_near(r.volume, volume, 1e-12, 0);
            assert_int_equal(r.euler, real[i].euler);
        }
        sfem_mesh_free(&m);
    }
    if (!found) skip();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_same_mesh_comes_from_each_format),
        cmocka_unit_test(the_same_mesh_comes_from_bytes_in_either_order),
        cmocka_unit_test(the_same_mesh_comes_from_the_two_files_of_tetgen),
        cmocka_unit_test(text_need_not_end_in_a_newline_or_a_zero),
        cmocka_unit_test(physical_groups_become_regions),
        cmocka_unit_test(vtk_fields_and_data_are_passed_over),
        cmocka_unit_test(numbers_are_read_to_the_nearest_double),
        cmocka_unit_test(numbers_agree_with_the_c_library),
        cmocka_unit_test(numbers_that_are_none_are_refused),
        cmocka_unit_test(malformed_gmsh_is_refused_with_its_line),
        cmocka_unit_test(malformed_vtk_is_refused_with_its_line),
        cmocka_unit_test(malformed_gmsh_2_is_refused_with_its_line),
        cmocka_unit_test(malformed_veg_is_refused_with_its_line),
        cmocka_unit_test(malformed_medit_is_refused_with_its_line),
        cmocka_unit_test(malformed_tetgen_is_refused_with_file_and_line),
        cmocka_unit_test(malformed_bytes_are_refused_with_their_place),
        cmocka_unit_test(other_data_is_refused),
        cmocka_unit_test(a_text_cut_anywhere_is_refused),
        cmocka_unit_test(damaged_texts_do_no_harm),
        cmocka_unit_test(files_of_tetgen_cut_anywhere_are_refused),
        cmocka_unit_test(physical_groups_of_gmsh_2_become_regions),
        cmocka_unit_test(materials_of_vega_become_regions),
        cmocka_unit_test(many_names_of_vega_cost_no_more_than_their_bytes),
        cmocka_unit_test(names_of_vega_are_told_apart),
        cmocka_unit_test(either_file_of_tetgen_names_both),
        cmocka_unit_test(vega_includes_files_beside_it),
        cmocka_unit_test(a_mesh_comes_back_as_it_was_written),
        cmocka_unit_test(the_locale_changes_nothing),
        cmocka_unit_test(vtu_holds_positions_cells_and_fields),
        cmocka_unit_test(pvd_lists_files_and_times),
        cmocka_unit_test(obj_holds_the_surface_at_the_given_positions),
        cmocka_unit_test(files_that_cannot_be_used_are_reported),
        cmocka_unit_test(a_surface_of_another_mesh_is_not_written),
        cmocka_unit_test(a_mesh_of_negative_counts_is_not_written),
        cmocka_unit_test(a_file_with_a_fault_is_named_with_the_line),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(real_meshes_are_read),
    };
    return run_all_tests(tests);
}
