/* fuzz.h - what the library reads from elsewhere, each as a target of a fuzzer: mesh and surface files, state blocks, packets.
 * tests/fuzz.c drives them by libFuzzer, tests/test_fuzz.c by a fixed sequence of mutations.
 *
 *     fuzz_targets[FUZZ_TARGETS]   name, seed(k, out), run(data, size)
 *     seed    writes the k-th good input to out [FUZZ_LARGEST], and returns its size; 0: there are no more
 *     run     gives the input to the library and uses what was accepted; aborts where a promise is broken
 *
 * A checksum is recomputed before a block or packet is read: it is no signature, and what matters is that everything
 * that passes the other checks is safe to use. Inputs for state blocks are lists of changes to a good block, and of
 * calls to make with what was accepted: fields are 4 or 8 bytes, and random bytes of a whole block seldom hit one.
 *
 * Include it after support.h, or alone, with SFEM_STATIC and SOFTFEM_IMPLEMENTATION defined: it needs the checksums.
 */
#ifndef SFEM_TESTS_FUZZ_H
#define SFEM_TESTS_FUZZ_H

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "softfem.h"
#include "linear.h"
#include "mesh_files.h"

enum { FUZZ_LARGEST = 8192 };

typedef struct fuzz_target {
    const char *name;
    size_t (*seed)(int k, unsigned char *out);
    void (*run)(const unsigned char *data, size_t size);
} fuzz_target;

#define fuzz_require(x)                                                                            \
    do {                                                                                           \
        if (x) break;                                                                              \
        fprintf(stderr, "%s:%d: not true: %s\n", __FILE__, __LINE__, #x);                          \
        abort();                                                                                   \
    } while (0)

static void fuzz_require_ok(sfem_status status, const sfem_error *err)
{
    if (status == SFEM_OK) return;
    fprintf(stderr, "%s\n", err->text);
    abort();
}

/* --------------------------------------------------------------------------------------------
 * mesh files
 * -------------------------------------------------------------------------------------------- */

static void fuzz_use_mesh(sfem_mesh *mesh)
{
    sfem_mesh_report report;
    sfem_surface surface;
    sfem_error err;
    sfem_int i;
    fuzz_require(mesh->nodes > 0 && mesh->tets > 0);
    for (i = 0; i < 4 * mesh->tets; ++i)
        fuzz_require(mesh->tet[i] >= 0 && mesh->tet[i] < mesh->nodes);
    for (i = 0; i < 3 * mesh->nodes; ++i) fuzz_require(isfinite(mesh->x[i]));
    (void)sfem_mesh_check(mesh, &report, &err);
    if (sfem_mesh_surface(mesh, NULL, &surface, &err) == SFEM_OK) sfem_surface_free(&surface);
    (void)sfem_mesh_renumber(mesh, NULL, &err);
    (void)sfem_mesh_remove_unused(mesh, NULL, &err);
    sfem_mesh_free(mesh);
}

/* Members are in order and there; regions are those of the tets. */
static void fuzz_use_sets(const sfem_mesh *m, sfem_mesh_sets *s)
{
    sfem_int i, k, tets = 0;
    for (i = 0; i < s->sets; ++i) {
        const sfem_set *g = s->set + i;
        for (k = 0; k < g->count; ++k) {
            fuzz_require(g->member[k] >= 0 && g->member[k] < (g->of_tets ? m->tets : m->nodes));
            fuzz_require(k == 0 || g->member[k] > g->member[k - 1]);
        }
        fuzz_require(sfem_mesh_sets_find(s, g->name, g->of_tets) != NULL);
    }
    for (i = 0; i < s->regions; ++i) {
        tets += s->region[i].tets;
        fuzz_require(sfem_mesh_sets_region(s, s->region[i].name) && s->region[i].material);
    }
    fuzz_require(tets == (m->region ? m->tets : 0));
    sfem_mesh_sets_free(s);
}

/* As it is, with its sets and options, and as a surface. */
static void fuzz_run_mesh(const unsigned char *data, size_t size)
{
    sfem_mesh_read_def def = sfem_default_mesh_read_def();
    sfem_mesh_sets sets;
    sfem_mesh_read_info info;
    sfem_surface s;
    sfem_error err;
    sfem_mesh mesh;
    sfem_int i;
    if (sfem_mesh_parse(data, size, NULL, &mesh, &err) == SFEM_OK) fuzz_use_mesh(&mesh);
    def.linear = size % 2;
    def.weld = size % 4 > 1;
    if (def.weld) def.weld_distance = size % 8 > 3 ? 0.25 : 0;
    if (sfem_mesh_parse_sets(data, size, &def, &mesh, &sets, &info, &err) == SFEM_OK) {
        fuzz_use_sets(&mesh, &sets);
        fuzz_use_mesh(&mesh);
    } else
        fuzz_require(err.text[0]);
    if (sfem_surface_parse(data, size, NULL, &s, &err) == SFEM_OK) {
        fuzz_require(s.nodes > 0 && s.triangles > 0);
        for (i = 0; i < 3 * s.triangles; ++i) fuzz_require(s.tri[i] >= 0 && s.tri[i] < s.nodes);
        sfem_surface_free(&s);
    } else
        fuzz_require(err.text[0]);
}

/* The two files of TetGen, a byte 0 between them. */
static void fuzz_run_tetgen(const unsigned char *data, size_t size)
{
    const unsigned char *zero = size ? (const unsigned char *)memchr(data, 0, size) : NULL;
    const size_t node = zero ? (size_t)(zero - data) : size, ele = zero ? size - node - 1 : 0;
    sfem_error err;
    sfem_mesh mesh;
    if (sfem_mesh_parse_tetgen(data, node, zero ? zero + 1 : data, ele, NULL, &mesh, &err) == SFEM_OK)
        fuzz_use_mesh(&mesh);
}

/* What was accepted is meshed: the result has to be sound, or the refusal a sentence. */
static void fuzz_run_surface(const unsigned char *data, size_t size)
{
    sfem_mesher_def def = sfem_default_mesher_def();
    sfem_surface s;
    sfem_mesh mesh;
    sfem_error err;
    sfem_int i;
    if (sfem_surface_parse(data, size, NULL, &s, &err) != SFEM_OK) {
        fuzz_require(err.text[0]);
        return;
    }
    fuzz_require(s.nodes > 0 && s.triangles > 0);
    for (i = 0; i < 3 * s.triangles; ++i) fuzz_require(s.tri[i] >= 0 && s.tri[i] < s.nodes);
    for (i = 0; i < 3 * s.nodes; ++i) fuzz_require(isfinite(s.x[i]));
    def.tets = 60;
    def.mode = size % 2 ? SFEM_CAGE : SFEM_FITTED;
    if (sfem_mesh_from_surface(&def, &s, &mesh, NULL, &err) == SFEM_OK) {
        fuzz_require_ok(sfem_mesh_check(&mesh, NULL, &err), &err);
        fuzz_use_mesh(&mesh);
    } else
        fuzz_require(err.text[0]);
    sfem_surface_free(&s);
}

static size_t fuzz_text(int k, int count, const char *const *text, unsigned char *out)
{
    if (k >= count) return 0;
    memcpy(out, text[k], strlen(text[k]));
    return strlen(text[k]);
}

/* Five nodes and two tets throughout. */
#define FUZZ_POINTS "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 1 1\n"

static void fuzz_put(unsigned char *out, size_t *at, const void *data, size_t bytes)
{
    memcpy(out + *at, data, bytes);
    *at += bytes;
}

static void fuzz_put_text(unsigned char *out, size_t *at, const char *text)
{
    fuzz_put(out, at, text, strlen(text));
}

/* The k-th of the files first .. last of mesh_files.h, 0 where there are no more. */
static size_t fuzz_file(int k, int first, int last, unsigned char *out)
{
    mesh_file f;
    if (first + k > last) return 0;
    mesh_file_sample(first + k, &f);
    memcpy(out, f.data, f.n);
    return f.n;
}

static const double fuzz_point[5][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1}};

static size_t fuzz_gmsh2_binary(unsigned char *out)
{
    static const int32_t one = 1, tets[3 + 2 * 7] = {4, 2, 2, 1, 7, 1, 1, 2, 3, 4, 2, 7, 1, 2, 3, 4, 5};
    size_t at = 0;
    int32_t i;
    fuzz_put_text(out, &at, "$MeshFormat\n2.2 1 8\n");
    fuzz_put(out, &at, &one, 4);
    fuzz_put_text(out, &at, "\n$EndMeshFormat\n$Nodes\n5\n");
    for (i = 1; i <= 5; ++i) fuzz_put(out, &at, &i, 4), fuzz_put(out, &at, fuzz_point[i - 1], 24);
    fuzz_put_text(out, &at, "\n$EndNodes\n$Elements\n2\n");
    fuzz_put(out, &at, tets, sizeof tets);
    fuzz_put_text(out, &at, "\n$EndElements\n");
    return at;
}

static size_t fuzz_gmsh4_binary(unsigned char *out)
{
    static const int32_t one = 1, volume[3] = {3, 1, 0}, tets[3] = {3, 1, 4};
    static const uint64_t entities[4] = {0, 0, 0, 1}, zero = 0, nodes[4] = {1, 5, 1, 5}, five = 5;
    static const uint64_t tags[5] = {1, 2, 3, 4, 5}, elements[4] = {1, 2, 1, 2}, two = 2;
    static const uint64_t rows[10] = {1, 1, 2, 3, 4, 2, 2, 3, 4, 5};
    size_t at = 0;
    fuzz_put_text(out, &at, "$MeshFormat\n4.1 1 8\n");
    fuzz_put(out, &at, &one, 4);
    fuzz_put_text(out, &at, "\n$EndMeshFormat\n$Entities\n");
    fuzz_put(out, &at, entities, sizeof entities);
    fuzz_put(out, &at, &one, 4);
    fuzz_put(out, &at, fuzz_point[0], 24), fuzz_put(out, &at, fuzz_point[4], 24);
    fuzz_put(out, &at, &zero, 8), fuzz_put(out, &at, &zero, 8);
    fuzz_put_text(out, &at, "\n$EndEntities\n$Nodes\n");
    fuzz_put(out, &at, nodes, sizeof nodes);
    fuzz_put(out, &at, volume, sizeof volume), fuzz_put(out, &at, &five, 8);
    fuzz_put(out, &at, tags, sizeof tags), fuzz_put(out, &at, fuzz_point, sizeof fuzz_point);
    fuzz_put_text(out, &at, "\n$EndNodes\n$Elements\n");
    fuzz_put(out, &at, elements, sizeof elements);
    fuzz_put(out, &at, tets, sizeof tets), fuzz_put(out, &at, &two, 8);
    fuzz_put(out, &at, rows, sizeof rows);
    fuzz_put_text(out, &at, "\n$EndElements\n");
    return at;
}

static size_t fuzz_seed_gmsh(int k, unsigned char *out)
{
    static const char *const text[2] = {
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 7 \"body\"\n$EndPhysicalNames\n$Nodes\n5\n"
        "10 0 0 0\n11 1 0 0\n2 0 1 0\n3 0 0 1\n4 1e0 1. +.1E+1\n$EndNodes\n$Elements\n3\n1 2 2 0 2 10 11 2\n"
        "2 4 2 7 4 10 11 2 3\n3 4 4 7 4 1 9 11 2 3 4\n$EndElements\n",
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Entities\n1 1 1 1\n1 0 0 0 0\n1 0 0 0 1 1 1 0 2 1 -1\n"
        "1 0 0 0 1 1 1 0 1 1\n1 0 0 0 1 1 1 1 7 1 1\n$EndEntities\n$Nodes\n2 5 1 11\n3 1 0 2\n10\n11\n0 0 0\n1 0 0\n"
        "3 1 1 3\n2\n3\n4\n0 1 0 0 0 0\n0 0 1 0 0 0\n1 1 1 0 0 0\n$EndNodes\n$Elements\n2 3 1 3\n2 1 2 1\n1 10 11 2\n"
        "3 1 4 2\n2 10 11 2 3\n3 11 2 3 4\n$EndElements\n"};
    if (k == 2) return fuzz_gmsh2_binary(out);
    if (k == 3) return fuzz_gmsh4_binary(out);
    return k < 2 ? fuzz_text(k, 2, text, out) : fuzz_file(k - 4, 13, 14, out);
}

static size_t fuzz_seed_vtk(int k, unsigned char *out)
{
    static const char *const text[2] = {
        "# vtk DataFile Version 3.0\na title\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 double\n" FUZZ_POINTS
        "CELLS 3 14\n4 0 1 2 3\n3 0 1 2\n4 1 2 3 4\nCELL_TYPES 3\n10\n5\n10\nPOINT_DATA 5\nSCALARS a float 1\n"
        "LOOKUP_TABLE default\n0 1 2 3 4\n",
        "# vtk DataFile Version 5.1\na title\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n" FUZZ_POINTS
        "METADATA\nINFORMATION 0\n\nCELLS 3 8\nOFFSETS vtktypeint64\n0 4 8\nCONNECTIVITY vtktypeint64\n"
        "0 1 2 3 1 2 3 4\nCELL_TYPES 2\n10\n10\n"};
    return k < 2 ? fuzz_text(k, 2, text, out) : fuzz_file(k - 2, 4, 6, out);
}

static size_t fuzz_seed_vtu(int k, unsigned char *out) { return fuzz_file(k, 0, 3, out); }

static size_t fuzz_seed_inp(int k, unsigned char *out)
{
    static const char *const text[1] = {
        "*NODE\n1,0,0,0\n2,2,0,0\n3,0,2,0\n4,0,0,2\n5,1,0,0\n6,1,1,0\n7,0,1,0\n8,0,0,1\n9,1,0,1\n10,0,1,1\n"
        "*ELEMENT,TYPE=C3D10,\nELSET=a\n1,1,2,3,4,5,6,7,8,\n9,10\n*ELEMENT,TYPE=C3D8R\n7,1,2,3,4,5,6,7,8\n*ELSET,ELSET=b\n"
        "a,7\n*NSET,NSET=c,GENERATE\n2,10,3\n*NSET,NSET=d\nc\n*SOLID SECTION,ELSET=b,MATERIAL=m\n*MATERIAL,NAME=m\n"};
    return k < 1 ? fuzz_text(k, 1, text, out) : fuzz_file(k - 1, 11, 12, out);
}

static size_t fuzz_seed_medit(int k, unsigned char *out)
{
    static const char *const text[1] = {
        "MeshVersionFormatted 2\nDimension\n3\nVertices\n5 # five\n0 0 0 0\n1d0 0 0 0\n0 1 0 3\n0 0 1 0\n1 1 1 -9\n"
        "Triangles 1\n1 2 3 7\nNormals 1\n0 0 1\nNewOne 1\n1 .5 -3\nTetrahedra\n2\n1 2 3 4 4\n2 3 4 5 -5\nEnd\n"};
    return k < 1 ? fuzz_text(k, 1, text, out) : fuzz_file(k - 1, 7, 10, out);
}

static size_t fuzz_seed_vega(int k, unsigned char *out)
{
    static const char *const text[1] = {
        "# a comment\n*VERTICES\n5 3 0 0\n1 0 0 0\n2, 1, 0, 0\n3 0 1 0\n4 0 0 1 # here\n5 1e0 1. +.1E+1\n*ELEMENTS\n"
        "TET\n2 4 0\n1 1 2 3 4\n2 2 3 4 5\n*MATERIAL soft\nENU, 1000, 1e6, .45\n*MATERIAL hard\nENU, 2e3, 1e9, .3\n"
        "*SET one\n2,\n*SET more\n1, 2\n*REGION\nallElements, soft\n*REGION\none, hard\n"};
    return fuzz_text(k, 1, text, out);
}

static size_t fuzz_seed_tetgen(int k, unsigned char *out)
{
    static const char node[] = "# a comment\n5 3 1 1\n1 0 0 0 .5 1\n2 1 0 0 .5 0\n3 0 1 0 .5 0 # c\n\n4 0 0 1 .5 1\n"
                               "5 1 1 1 .5 1\n";
    static const char ele[] = "2 4 1\n1 1 2 3 4 4\n2 2 3 4 5 6\n# the end\n";
    if (k) return 0;
    memcpy(out, node, sizeof node);
    memcpy(out + sizeof node, ele, sizeof ele - 1);
    return sizeof node + sizeof ele - 1;
}

/* --------------------------------------------------------------------------------------------
 * changes to a block, and calls to make with it
 * -------------------------------------------------------------------------------------------- */

typedef struct fuzz_input {
    const unsigned char *at, *end;
} fuzz_input;

static unsigned fuzz_byte(fuzz_input *in) { return in->at < in->end ? *in->at++ : 0u; }

static double fuzz_real(unsigned byte)
{
    static const double value[] = {0,     -0.0,     1,      -1,       0.5,   2,         1e-3,     1e3,      1e-30,  1e30,
                                   1e-310, 1.7e308, -1.7e308, INFINITY, -INFINITY, NAN, 1e154,    -1e154,   0.01,   0.25,
                                   1e10,   -1e10,   6,        3.14159,  1e38,      1e39, 4294967296.0, 1e19, 2147483648.0};
    return value[byte % (sizeof value / sizeof *value)];
}

static int32_t fuzz_int(unsigned byte)
{
    static const int32_t value[] = {0, 1, -1, 2, 3, 4, 5, 6, 7, 8, 16, 31, 32, 63, 64, 100, 255, 256, 1 << 20, 1 << 30,
                                    INT32_MAX, INT32_MAX - 1, INT32_MIN, INT32_MIN + 1};
    return value[byte % (sizeof value / sizeof *value)];
}

/* Somewhere in the block, of `wide` bytes: anywhere, or in its first or last 512 bytes, where most counts stand. */
static size_t fuzz_place(fuzz_input *in, unsigned where, size_t bytes, size_t wide)
{
    const size_t at = 4 * (size_t)(fuzz_byte(in) | fuzz_byte(in) << 8), few = bytes < 512 ? bytes : 512;
    if (where == 1) return at % (few - wide);
    if (where == 2) return bytes - few + at % (few - wide);
    return at % (bytes - wide);
}

/* Up to 15 changes of a block of more than 64 bytes. */
static void fuzz_change(fuzz_input *in, unsigned char *block, size_t bytes)
{
    unsigned count = fuzz_byte(in) & 15;
    while (count--) {
        const unsigned kind = fuzz_byte(in);
        const size_t wide = (kind & 7) == 5 ? 64 : 8, at = fuzz_place(in, kind >> 6, bytes, wide);
        double real;
        int32_t number;
        size_t k;
        switch (kind & 7) {
        case 0:
        case 1:
            for (k = 0; k < (kind & 1 ? 4 : 8); ++k) block[at + k] = (unsigned char)fuzz_byte(in);
            break;
        case 2:
        case 3:
            real = fuzz_real(fuzz_byte(in));
            memcpy(block + at, &real, sizeof real);
            break;
        case 4:
        case 6:
            number = fuzz_int(fuzz_byte(in));
            memcpy(block + at, &number, sizeof number);
            break;
        case 5: memmove(block + at, block + fuzz_place(in, kind >> 3 & 3, bytes, wide), wide); break;
        default:
            memcpy(&real, block + at, sizeof real);
            real *= fuzz_real(fuzz_byte(in));
            memcpy(block + at, &real, sizeof real);
        }
    }
}

/* An input that changes nothing and makes the calls first, first + 1, ..., which reaches all of them. */
static size_t fuzz_seed_calls(int k, int scenes, int calls, unsigned char *out)
{
    int i;
    if (k >= scenes) return 0;
    out[0] = (unsigned char)k;
    out[1] = 0;
    for (i = 0; i < calls; ++i) out[2 + i] = (unsigned char)((i + 5 * k) % calls);
    return (size_t)(2 + calls);
}

/* A tetrahedron in every format of surfaces, and two needles. */
static size_t fuzz_seed_surface(int k, unsigned char *out)
{
    static const char *const text[] = {
        "# a comment\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nf 1//1 3//1 2//1\nf 1 2 4\nf -3 -2 -1\n"
        "f 1/1/1 4/2/2 3/3/3\n",
        "v 0 0 0\nv 1000. 5 0.5 0.5\nv 0 1 0\nv 0 0 1\nf 1//1 3//1 2//1\nf 1 2 4\n", /* needles, once slow */
        "solid a\nfacet normal 0 0 -1\nouter loop\nvertex 0 0 0\nvertex 0 1 0\nvertex 1 0 0\nendloop\nendfacet\n"
        "facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 0 1\nendloop\nendfacet\n"
        "facet normal 0 0 0\nouter loop\nvertex 1 0 0\nvertex 0 1 0\nvertex 0 0 1\nendloop\nendfacet\n"
        "facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 0 0 1\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n",
        "OFF\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1 255 0 0\n3 0 1 3\n3 1 2 3\n3 0 3 2\n",
        "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "property uchar red\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n0 0 0 1\n1 0 0 2\n0 1 0 3\n"
        "0 0 1 4\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"};
    static const unsigned char face[4][3] = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}};
    const int texts = (int)(sizeof text / sizeof *text);
    unsigned char count[4] = {4, 0, 0, 0}, zero[80] = {0};
    size_t at = 0;
    int t, i, c;
    if (k < texts) return fuzz_text(k, texts, text, out);
    if (k > texts + 2) return 0;
    if (k == texts) { /* STL, little-endian floats: 0 and 1 */
        static const unsigned char one[2][4] = {{0, 0, 0, 0}, {0, 0, 0x80, 0x3f}};
        fuzz_put(out, &at, zero, 80), fuzz_put(out, &at, count, 4);
        for (t = 0; t < 4; ++t) {
            fuzz_put(out, &at, zero, 12);
            for (i = 0; i < 3; ++i)
                for (c = 0; c < 3; ++c) fuzz_put(out, &at, one[face[t][i] == c + 1], 4);
            fuzz_put(out, &at, zero, 2);
        }
        return at;
    }
    fuzz_put_text(out, &at, "ply\nformat ");
    fuzz_put_text(out, &at, k == texts + 1 ? "binary_little_endian 1.0\n" : "binary_big_endian 1.0\n");
    fuzz_put_text(out, &at, "element vertex 4\nproperty float x\nproperty short y\nproperty int8 z\nelement face 4\n"
                            "property list uchar ushort vertex_index\nend_header\n");
    for (i = 0; i < 4; ++i) {
        static const unsigned char x[2][2][4] = {{{0, 0, 0, 0}, {0, 0, 0x80, 0x3f}}, {{0, 0, 0, 0}, {0x3f, 0x80, 0, 0}}};
        const int big = k == texts + 2;
        unsigned char y[2] = {0, 0}, z = (unsigned char)(i == 3);
        y[big] = (unsigned char)(i == 2);
        fuzz_put(out, &at, x[big][i == 1], 4), fuzz_put(out, &at, y, 2), fuzz_put(out, &at, &z, 1);
    }
    for (t = 0; t < 4; ++t) {
        unsigned char row[7] = {3, 0, 0, 0, 0, 0, 0};
        for (i = 0; i < 3; ++i) row[1 + 2 * i + (k == texts + 2)] = face[t][i];
        fuzz_put(out, &at, row, 7);
    }
    return at;
}

/* --------------------------------------------------------------------------------------------
 * bodies
 * -------------------------------------------------------------------------------------------- */

enum { FUZZ_SCENES = 10, FUZZ_STAGES = 3, FUZZ_BODY_CALLS = 25, FUZZ_MOST_CALLS = 12 };

typedef struct fuzz_scene {
    sfem_model *model;
    sfem_body_def def;
    sfem_damage_def damage;
    sfem_body *body; /* keeps the factors alive */
    unsigned char *block[FUZZ_STAGES];
    size_t bytes;
} fuzz_scene;

static const sfem_int fuzz_pins[4] = {0, 1, 2, 3};
static const unsigned char fuzz_axes[4] = {7, 7, 7, SFEM_AXIS_Y};

static sfem_model *fuzz_model(sfem_law law, sfem_mass mass)
{
    const sfem_int cells[3] = {2, 1, 1};
    const sfem_real size[3] = {0.2, 0.1, 0.1};
    sfem_model_def def = linear_model_def();
    sfem_model *model = NULL;
    sfem_mesh mesh;
    sfem_error err;
    fuzz_require_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), &err);
    def.mesh = &mesh;
    def.material.law = law;
    def.material.young = 1e5;
    def.material.mass_damping = 0.1;
    def.mass = mass;
    fuzz_require_ok(sfem_model_create(&def, &model, &err), &err);
    sfem_mesh_free(&mesh);
    return model;
}

static const sfem_int fuzz_region[6] = {11, 8, 9, 10, 6, 7};

static sfem_body_def fuzz_body_def(int scene, sfem_damage_def *damage)
{
    static const sfem_integrator by[FUZZ_SCENES] = {SFEM_NEWMARK, SFEM_PQR,     SFEM_PQR,   SFEM_PQR,      SFEM_PQR,
                                                    SFEM_CENTRAL, SFEM_KR_ALPHA, SFEM_BATHE, SFEM_KR_ALPHA, SFEM_HHT};
    sfem_body_def def = sfem_default_body_def();
    def.integrator = by[scene];
    def.max_handles = 3;
    def.max_handle_nodes = 15;
    if (scene % 3 == 0) def.handle_compliance = 0;
    if (scene % 3 == 1) def.handle_max_force = 4;
    def.gravity[2] = -9.81;
    if (scene % 2) def.sleep_tolerance = 0.02, def.sleep_time = 0.02;
    if (scene % 3) def.pins = fuzz_pins, def.pin_axes = fuzz_axes, def.pin_count = 4;
    if (scene == 2) def.refactorise = 0.5;
    if (scene == 4) def.accuracy = 1;
    if (scene >= 3 && scene <= 5) {
        *damage = sfem_default_damage_def();
        damage->criterion = scene == 3 ? SFEM_BREAK_DUCTILE : scene == 4 ? SFEM_BREAK_ENERGY : SFEM_BREAK_STRAIN;
        damage->soften[1] = 0.2;
        damage->toughness = 1;
        damage->strength = 0.1;
        if (scene == 4) damage->law = SFEM_DAMAGE_ZSZ;
        def.damage = damage;
    }
    return def;
}

static double fuzz_body_h(int scene) { return scene == 5 ? 1e-4 : 0.01; }

static fuzz_scene *fuzz_body_scene(int k)
{
    static fuzz_scene scenes[FUZZ_SCENES];
    static const sfem_law law[FUZZ_SCENES] = {SFEM_LINEAR,       SFEM_LINEAR, SFEM_NEOHOOKEAN,   SFEM_COROTATIONAL,
                                              SFEM_COROTATIONAL, SFEM_LINEAR, SFEM_COROTATIONAL, SFEM_COROTATIONAL,
                                              SFEM_LINEAR,       SFEM_LINEAR};
    fuzz_scene *s = scenes + k;
    const sfem_real f[3] = {1, 2, 3}, bary[4] = {0.4, 0.3, 0.2, 0.1};
    sfem_real target[3];
    sfem_int handle[2];
    sfem_error err;
    int stage, i;
    if (s->model) return s;
    s->model = fuzz_model(law[k], k == 0 || k == 8 || k == 9 ? SFEM_MASS_CONSISTENT : SFEM_MASS_LUMPED);
    s->def = fuzz_body_def(k, &s->damage);
    fuzz_require_ok(sfem_body_create(s->model, &s->def, &s->body, &err), &err);
    s->bytes = sfem_body_state_size(s->body);
    fuzz_require_ok(sfem_body_grab_node(s->body, 11, handle, &err), &err);
    fuzz_require_ok(sfem_body_grab_point(s->body, 7, bary, handle + 1, &err), &err);
    for (stage = 0; stage < FUZZ_STAGES; ++stage) {
        s->block[stage] = (unsigned char *)malloc(s->bytes);
        for (i = 0; i < (stage == 2 ? 6 : stage); ++i) fuzz_require_ok(sfem_body_step(s->body, fuzz_body_h(k), &err), &err);
        if (stage == 1) {
            sfem_body_handle_position(s->body, handle[0], target);
            target[2] += 0.01;
            fuzz_require_ok(sfem_body_move_handle(s->body, handle[0], target, &err), &err);
            fuzz_require_ok(sfem_body_add_lasting_force(s->body, 9, f, &err), &err);
            if (s->def.damage) fuzz_require_ok(sfem_body_break_edge(s->body, 9, 11, &err), &err);
        }
        sfem_body_save_state(s->body, s->block[stage]);
    }
    return s;
}

static int fuzz_first_handle(const sfem_body *b, sfem_int *handle)
{
    for (*handle = 0; *handle < b->def.max_handles; ++*handle)
        if (b->state.handle[*handle].used) return 1;
    return 0;
}

static void fuzz_look_at_body(sfem_body *b)
{
    sfem_real x[36];
    float small[36];
    sfem_int handle, i, count;
    sfem_piece *pieces;
    fuzz_require(b->model->mesh.nodes == 12);
    sfem_body_positions(b, x);
    sfem_body_velocities(b, x);
    sfem_body_to_floats(b, small, NULL, 12);
    (void)sfem_body_energy(b);
    (void)sfem_body_get_info(b);
    (void)sfem_body_get_refactorisation(b);
    (void)sfem_body_newton(b);
    sfem_body_reactions(b, x);
    if (fuzz_first_handle(b, &handle)) {
        sfem_body_handle_force(b, handle, x);
        sfem_body_handle_position(b, handle, x);
        (void)sfem_body_get_handle(b, handle);
    }
    if (!b->damage) return;
    count = sfem_body_fracture(b).pieces;
    fuzz_require(count >= 1 && count <= 12);
    pieces = (sfem_piece *)malloc((size_t)count * sizeof *pieces);
    sfem_body_pieces(b, pieces);
    free(pieces);
    for (i = 0; i < 12; ++i) fuzz_require(sfem_body_piece_of(b)[i] < count);
    (void)sfem_body_breaks(b, &count);
    (void)sfem_body_edge_left(b, 9, 11);
}

static void fuzz_break_body(sfem_body *b, unsigned call)
{
    const sfem_real from[9] = {0.05, -1, -1, 0.05, 1, -1, 0.05, 0, 2}, to[9] = {0.06, -1, -1, 0.06, 1, -1, 0.06, 0, 2};
    sfem_fragments pieces;
    sfem_error err;
    sfem_real *x;
    if (!b->damage) return;
    if (call == 0) (void)sfem_body_break_edge(b, 8, 9, &err);
    else if (call == 1) (void)sfem_body_cut(b, from, to, NULL, &err);
    else if (call == 2) sfem_body_heal(b);
    else if (sfem_body_fragments(b, NULL, &pieces, &err) == SFEM_OK) {
        x = (sfem_real *)malloc(3 * (size_t)(pieces.vertices + 1) * sizeof *x);
        sfem_body_fragment_positions(b, &pieces, x);
        free(x);
        sfem_fragments_free(&pieces);
    }
}

/* A saved state can be loaded again, unless the block held numbers like 1e300, of which velocities overflow. */
static void fuzz_reload_body(sfem_body *b)
{
    const size_t bytes = sfem_body_state_size(b);
    void *block = malloc(bytes);
    sfem_error err;
    sfem_body_save_state(b, block);
    if (sfem_body_load_state(b, block, bytes, &err) != SFEM_OK) fuzz_require(err.status == SFEM_FORMAT);
    free(block);
}

static void fuzz_call_body(sfem_body *b, unsigned call, double h)
{
    const sfem_real f[3] = {0, 5, 0}, bary[4] = {0.25, 0.25, 0.25, 0.25}, place[3] = {0.1, 0.1, 0.15};
    sfem_real load[36];
    sfem_int handle, i;
    sfem_error err;
    switch (call % FUZZ_BODY_CALLS) {
    case 0: (void)sfem_body_step(b, h, &err); break;
    case 1: (void)sfem_body_step(b, h, &err); break;
    case 2: (void)sfem_body_step(b, h / 2, &err); break;
    case 3: for (i = 0; i < 36; ++i) load[i] = i % 5;
            (void)sfem_body_set_lasting_force(b, load, &err); break;
    case 4: (void)sfem_body_add_lasting_force(b, 7, f, &err); break;
    case 5: if (fuzz_first_handle(b, &handle)) (void)sfem_body_move_handle(b, handle, place, &err);
            break;
    case 6: if (fuzz_first_handle(b, &handle)) sfem_body_release_handle(b, handle);
            break;
    case 7: (void)sfem_body_grab_node(b, 10, &handle, &err); break;
    case 8: if (call % 2) (void)sfem_body_grab_point(b, 3, bary, &handle, &err);
            else (void)sfem_body_grab_region(b, 6, fuzz_region, NULL, &handle, &err);
            break;
    case 9: (void)sfem_body_set_pins(b, 3, fuzz_pins, NULL, &err); break;
    case 10: (void)sfem_body_set_gravity(b, f, &err); break;
    case 11: fuzz_look_at_body(b); break;
    case 12: (void)sfem_body_set_state(b, NULL, NULL, &err); break;
    case 13: (void)sfem_body_solve_static(b, &err); break;
    case 14: (void)sfem_body_predict(b, h, &err); break;
    case 15: if (sfem_body_predict(b, h, &err) == SFEM_OK && sfem_body_solve(b, &err) == SFEM_OK &&
                 sfem_body_add_impulse(b, 9, f, &err) == SFEM_OK) (void)sfem_body_finish(b, &err);
             break;
    case 16:
    case 17:
    case 18:
    case 19: fuzz_break_body(b, call % FUZZ_BODY_CALLS - 16); break;
    case 20: sfem_body_wake(b); break;
    case 21: if (b->def.refactorise > 0) (void)sfem_body_refactorise(b, NULL, &err);
             break;
    case 22: (void)sfem_body_move_pin(b, fuzz_pins[1], place, &err); break;
    case 23: sfem_body_start(b); break;
    default: fuzz_reload_body(b);
    }
}

static void fuzz_run_body(const unsigned char *data, size_t size)
{
    fuzz_input in;
    const int k = size ? data[0] % FUZZ_SCENES : 0, stage = size ? data[0] / FUZZ_SCENES % FUZZ_STAGES : 0;
    const fuzz_scene *s = fuzz_body_scene(k);
    unsigned char *block = (unsigned char *)malloc(2 * s->bytes), *saved = block + s->bytes;
    sfem_body *b = NULL;
    sfem_error err;
    int i, calls;
    in.at = data + (size > 0), in.end = data + size;
    memcpy(block, s->block[stage], s->bytes);
    fuzz_change(&in, block, s->bytes);
    memcpy(block, s->block[stage], sizeof(sfemi_saved_head));
    sfemi_saved_seal(block);
    fuzz_require_ok(sfem_body_create(s->model, &s->def, &b, &err), &err);
    sfem_body_save_state(b, saved);
    if (sfem_body_load_state(b, block, s->bytes, &err) == SFEM_OK) {
        for (calls = 0; in.at < in.end && calls < FUZZ_MOST_CALLS; ++calls)
            fuzz_call_body(b, fuzz_byte(&in), fuzz_body_h(k));
        for (i = 0; i < 2; ++i) (void)sfem_body_step(b, fuzz_body_h(k), &err);
        for (i = 0; i < 36; ++i) fuzz_require(isfinite(sfem_body_displacement(b)[i]));
        fuzz_look_at_body(b);
        fuzz_reload_body(b);
    } else {
        fuzz_require(err.status == SFEM_FORMAT && err.text[0]);
        sfem_body_save_state(b, block);
        fuzz_require(memcmp(block, saved, s->bytes) == 0); /* the body is as it was */
    }
    sfem_body_free(b);
    free(block);
}

static size_t fuzz_seed_body(int k, unsigned char *out)
{
    return fuzz_seed_calls(k, FUZZ_SCENES * FUZZ_STAGES, FUZZ_BODY_CALLS, out);
}

/* --------------------------------------------------------------------------------------------
 * reduced models and modal bodies
 * -------------------------------------------------------------------------------------------- */

enum { FUZZ_MODES = 9, FUZZ_MODAL_SCENES = 4, FUZZ_MODAL_CALLS = 17 };

/* Held, or free with a frame. */
static sfem_reduced *fuzz_reduced(int loose)
{
    static sfem_reduced *reduced[2];
    sfem_reduced_def def = sfem_default_reduced_def();
    sfem_modes_def wanted = sfem_default_modes_def();
    sfem_model *model;
    sfem_modes modes;
    sfem_error err;
    if (reduced[loose]) return reduced[loose];
    model = fuzz_model(SFEM_LINEAR, SFEM_MASS_LUMPED);
    wanted.modes = FUZZ_MODES;
    if (!loose) wanted.pins = fuzz_pins, wanted.pin_count = 4;
    fuzz_require_ok(sfem_modes_create(model, &wanted, &modes, &err), &err);
    def.gravity_groups = 3;
    def.stiffness_damping = 1e-3;
    def.free = loose;
    fuzz_require_ok(sfem_reduced_create(model, &modes, &def, &reduced[loose], &err), &err);
    sfem_modes_free(&modes);
    sfem_model_free(model);
    return reduced[loose];
}

static sfem_modal *fuzz_modal(sfem_reduced *reduced, int scene)
{
    static const sfem_modal_integrator by[FUZZ_MODAL_SCENES] = {SFEM_MODAL_FITTED, SFEM_MODAL_EXACT, SFEM_MODAL_NEWMARK,
                                                                SFEM_MODAL_FITTED};
    static const sfem_warp warp[FUZZ_MODAL_SCENES] = {SFEM_WARP_PATH, SFEM_WARP_NONE, SFEM_WARP_ROTATION,
                                                      SFEM_WARP_PATH};
    sfem_modal_def def = sfem_default_modal_def();
    sfem_modal *b = NULL;
    sfem_error err;
    def.integrator = by[scene];
    def.warp = warp[scene];
    def.max_handles = 3;
    def.max_handle_nodes = 6;
    def.frozen_rotations = scene == 2;
    def.tolerance = scene % 2 ? 1e-6 : 0;
    def.gravity[1] = -9.81;
    fuzz_require_ok(sfem_modal_create(reduced, &def, &b, &err), &err);
    return b;
}

static int fuzz_first_modal_handle(const sfem_modal *b, unsigned from, sfem_int *handle)
{
    sfem_int k;
    for (k = 0; k < b->def.max_handles; ++k) {
        *handle = (k + (sfem_int)from) % b->def.max_handles;
        if (b->handle[*handle].used) return 1;
    }
    return 0;
}

static void fuzz_look_at_modal(sfem_modal *b)
{
    const sfem_int nodes = b->reduced->head->nodes;
    sfem_reduced_view *view = NULL;
    sfem_real *x = (sfem_real *)malloc((3 * (size_t)nodes + b->stride + 24) * sizeof *x);
    sfem_int handle;
    sfem_error err;
    (void)sfem_modal_get_info(b);
    (void)sfem_modal_rigid(b);
    sfem_modal_node(b, nodes - 1, x, x + 3, x + 6);
    sfem_modal_load(b, x);
    if (fuzz_first_modal_handle(b, 0, &handle)) {
        sfem_modal_handle_position(b, handle, x);
        sfem_modal_handle_force(b, handle, x);
        sfem_modal_handle_modal_force(b, handle, x);
    }
    if (sfem_reduced_view_create(b->reduced, nodes, NULL, SFEM_MIXED, &view, &err) == SFEM_OK) {
        sfem_modal_positions(b, view, x);
        sfem_reduced_view_free(view);
    }
    free(x);
}

/* The state of a body that is taken hold of at speeds of 1e300 overflows, and is not loaded again. */
static void fuzz_reload_modal(sfem_modal *b)
{
    const size_t bytes = sfem_modal_state_size(b);
    void *block = malloc(bytes);
    sfem_error err;
    sfem_modal_save_state(b, block);
    if (sfem_modal_load_state(b, block, bytes, &err) != SFEM_OK) fuzz_require(err.status == SFEM_FORMAT);
    free(block);
}

static void fuzz_call_modal(sfem_modal *b, unsigned call)
{
    const sfem_int nodes = b->reduced->head->nodes, region[3] = {0, nodes - 1, nodes / 2};
    const sfem_real f[3] = {0, 2, 1}, place[3] = {0.2, 0.1, 0.12};
    sfem_real *load;
    sfem_rigid rigid;
    sfem_int handle, i;
    sfem_error err;
    switch (call % FUZZ_MODAL_CALLS) {
    case 0: (void)sfem_modal_step(b, 0.01, &err); break;
    case 1: (void)sfem_modal_step(b, 0.02, &err); break;
    case 2: for (i = 0; i < nodes; ++i) (void)sfem_modal_add_lasting_force(b, i, f, &err);
            break;
    case 3: (void)sfem_modal_add_lasting_force(b, nodes - 1, f, &err); break;
    case 4: (void)sfem_modal_set_lasting_force(b, NULL, &err); break;
    case 5: (void)sfem_modal_set_gravity(b, f, &err); break;
    case 6: if (fuzz_first_modal_handle(b, 0, &handle)) (void)sfem_modal_move_handle(b, handle, place, &err);
            break;
    case 7:
    case 8: if (fuzz_first_modal_handle(b, call % 3, &handle)) sfem_modal_release_handle(b, handle);
            break;
    case 9: (void)sfem_modal_grab_node(b, nodes - 1, &handle, &err); break;
    case 10: (void)sfem_modal_grab_region(b, 3, region, NULL, &handle, &err); break;
    case 11: (void)sfem_modal_solve_static(b, NULL, &err); break;
    case 12: fuzz_look_at_modal(b); break;
    case 13: sfem_modal_start(b); break;
    case 14: load = (sfem_real *)calloc(b->stride + 1, sizeof *load);
             (void)sfem_modal_step_with(b, load, 0.01, 0.25, 0.5, &err);
             (void)sfem_modal_set_coordinates(b, load, load, call & 128 ? load : NULL, &err);
             free(load); break;
    case 15: rigid = sfem_modal_rigid(b);
             (void)sfem_modal_set_rigid(b, &rigid, &err); break;
    default: fuzz_reload_modal(b);
    }
}

static void fuzz_use_modal(sfem_modal *b, fuzz_input *in)
{
    sfem_error err;
    size_t k;
    int calls;
    for (calls = 0; in->at < in->end && calls < FUZZ_MOST_CALLS; ++calls) fuzz_call_modal(b, fuzz_byte(in));
    (void)sfem_modal_step(b, 0.01, &err);
    for (k = 0; k < b->m; ++k) fuzz_require(isfinite(b->q[k]));
    fuzz_look_at_modal(b);
    fuzz_reload_modal(b);
}

/* The good blocks, made once: of a fresh body, and of one with handles and forces that has moved. */
static const unsigned char *fuzz_modal_block(int scene, int stage, size_t *bytes)
{
    static unsigned char *block[FUZZ_MODAL_SCENES][2];
    static size_t size[FUZZ_MODAL_SCENES];
    const sfem_int region[3] = {1, 11, 7};
    const sfem_real f[3] = {0, 0, 2};
    sfem_int handle, i;
    sfem_error err;
    if (!block[scene][0]) {
        sfem_modal *b = fuzz_modal(fuzz_reduced(scene > 1), scene);
        size[scene] = sfem_modal_state_size(b);
        block[scene][0] = (unsigned char *)malloc(size[scene]);
        block[scene][1] = (unsigned char *)malloc(size[scene]);
        sfem_modal_save_state(b, block[scene][0]);
        fuzz_require_ok(sfem_modal_grab_node(b, 10, &handle, &err), &err);
        fuzz_require_ok(sfem_modal_grab_region(b, 3, region, NULL, &handle, &err), &err);
        for (i = 8; i < 12; ++i) fuzz_require_ok(sfem_modal_add_lasting_force(b, i, f, &err), &err);
        for (i = 0; i < 4; ++i) fuzz_require_ok(sfem_modal_step(b, 0.01, &err), &err);
        sfem_modal_save_state(b, block[scene][1]);
        sfem_modal_free(b);
    }
    *bytes = size[scene];
    return block[scene][stage];
}

static void fuzz_run_modal(const unsigned char *data, size_t size)
{
    const int scene = size ? data[0] % FUZZ_MODAL_SCENES : 0, stage = size ? data[0] / FUZZ_MODAL_SCENES % 2 : 0;
    size_t bytes;
    const unsigned char *good = fuzz_modal_block(scene, stage, &bytes);
    unsigned char *block = (unsigned char *)malloc(2 * bytes), *saved = block + bytes;
    sfem_modal *b = fuzz_modal(fuzz_reduced(scene > 1), scene);
    fuzz_input in;
    sfem_error err;
    in.at = data + (size > 0), in.end = data + size;
    memcpy(block, good, bytes);
    fuzz_change(&in, block, bytes);
    memcpy(block, good, sizeof(sfemi_saved_head));
    sfemi_saved_seal(block);
    sfem_modal_save_state(b, saved);
    if (sfem_modal_load_state(b, block, bytes, &err) == SFEM_OK)
        fuzz_use_modal(b, &in);
    else {
        fuzz_require(err.status == SFEM_FORMAT && err.text[0]);
        sfem_modal_save_state(b, block);
        fuzz_require(memcmp(block, saved, bytes) == 0);
    }
    sfem_modal_free(b);
    free(block);
}

static size_t fuzz_seed_modal(int k, unsigned char *out)
{
    return fuzz_seed_calls(k, 2 * FUZZ_MODAL_SCENES, FUZZ_MODAL_CALLS, out);
}

/* The block of a reduced model, whose sizes may change, too; then a body of it. */
static void fuzz_run_reduced(const unsigned char *data, size_t size)
{
    const int scene = size ? data[0] % FUZZ_MODAL_SCENES : 0;
    sfem_reduced *good = fuzz_reduced(scene > 1), *r = NULL;
    const size_t bytes = sfem_reduced_size(good);
    unsigned char *block = (unsigned char *)malloc(bytes);
    fuzz_input in;
    sfem_error err;
    in.at = data + (size > 0), in.end = data + size;
    memcpy(block, good->head, bytes);
    fuzz_change(&in, block, bytes);
    memcpy(block, good->head, sizeof(sfemi_saved_head));
    sfemi_saved_seal(block);
    if (sfem_reduced_load(block, bytes, NULL, &r, &err) == SFEM_OK) {
        sfem_modal *b = fuzz_modal(r, scene);
        sfem_real *row = (sfem_real *)malloc((3 * b->m + 1) * sizeof *row);
        (void)sfem_reduced_get_info(r);
        sfem_reduced_node_modes(r, 0, row, row);
        fuzz_use_modal(b, &in);
        sfem_modal_free(b);
        sfem_reduced_free(r);
        free(row);
    } else
        fuzz_require(err.status == SFEM_FORMAT && err.text[0]);
    free(block);
}

static size_t fuzz_seed_reduced(int k, unsigned char *out)
{
    return fuzz_seed_calls(k, FUZZ_MODAL_SCENES, FUZZ_MODAL_CALLS, out);
}

/* --------------------------------------------------------------------------------------------
 * packets of the link
 * -------------------------------------------------------------------------------------------- */

enum { FUZZ_LINK_MODES = 2, FUZZ_LINK_CALLS = 8 };

/* Byte 0 says how losses are bridged; then one byte a call: a step, a packet by the sender, a packet with changes. */
static void fuzz_run_link(const unsigned char *data, size_t size)
{
    static const sfem_real stiffness[FUZZ_LINK_MODES] = {100, 4e4};
    const sfem_real a[FUZZ_LINK_MODES] = {1, -2};
    unsigned char packet[256];
    size_t bytes = 0;
    sfem_link_def def = sfem_default_link_def();
    sfem_sender *sender = NULL;
    sfem_receiver *r = NULL;
    const unsigned kind = size ? data[0] : 0;
    fuzz_input in;
    sfem_error err;
    int k, calls;
    in.at = data + (size > 0), in.end = data + size;
    def.modes = FUZZ_LINK_MODES;
    def.window = 4;
    def.key_every = 5;
    def.lost = (sfem_lost)(kind % 4);
    def.precision = kind >> 2 & 1 ? SFEM_MIXED : SFEM_DOUBLE;
    def.keep_late = !(kind >> 3 & 1);
    def.first = kind >> 4 & 1 ? 0xfffffffeu : 3;
    def.stiffness = stiffness;
    fuzz_require_ok(sfem_sender_create(&def, &sender, &err), &err);
    fuzz_require_ok(sfem_receiver_create(&def, &r, &err), &err);
    for (calls = 0; in.at < in.end && calls < 64; ++calls) {
        const unsigned call = fuzz_byte(&in) % FUZZ_LINK_CALLS;
        if (call < 2) (void)sfem_receiver_step(r);
        if (call == 2) sfem_sender_set_held(sender, (int)(fuzz_byte(&in) & 1));
        if (call == 3) sfem_sender_request_key(sender);
        if (call == 7) sfem_receiver_restart(r, fuzz_byte(&in) & 3);
        if (call == 4 || call == 5 || !bytes)
            fuzz_require_ok(sfem_sender_write(sender, a, a, a, packet, sizeof packet, &bytes, &err), &err);
        if (call == 4) (void)sfem_receiver_read(r, packet, bytes);
        if (call != 6) continue;
        fuzz_change(&in, packet, bytes < 72 ? 72 : bytes);
        if (fuzz_byte(&in) & 1) { /* a key frame or not, of either precision, with the length that goes with it */
            const unsigned want = fuzz_byte(&in);
            packet[9] = want & 1 ? SFEMI_LINK_KEY : SFEMI_LINK_ACCELERATIONS;
            packet[10] = want & 2 ? 4 : 8;
            bytes = sfemi_link_size(FUZZ_LINK_MODES, packet[9] == SFEMI_LINK_KEY, packet[10]);
        }
        sfemi_link_put(packet + 4, sfemi_link_checksum(&r->crc, packet + 8, bytes - 8));
        (void)sfem_receiver_read(r, packet, bytes);
    }
    (void)sfem_receiver_lead(r);
    (void)sfem_receiver_get_info(r);
    for (k = 0; k < FUZZ_LINK_MODES; ++k) {
        fuzz_require(isfinite(sfem_receiver_coordinates(r)[k]) && isfinite(sfem_receiver_coordinate_velocities(r)[k]));
        fuzz_require(isfinite(sfem_receiver_coordinate_accelerations(r)[k]));
    }
    sfem_receiver_free(r);
    sfem_sender_free(sender);
}

static size_t fuzz_seed_link(int k, unsigned char *out)
{
    int i;
    if (k >= 32) return 0;
    out[0] = (unsigned char)k;
    for (i = 1; i < 60; ++i) out[i] = (unsigned char)("444104564110414450414246411417"[i % 30] - '0');
    return 60;
}

/* -------------------------------------------------------------------------------------------- */

enum { FUZZ_TARGETS = 12 };

static const fuzz_target fuzz_targets[FUZZ_TARGETS] = {
    {"gmsh", fuzz_seed_gmsh, fuzz_run_mesh},          {"vtk", fuzz_seed_vtk, fuzz_run_mesh},
    {"medit", fuzz_seed_medit, fuzz_run_mesh},        {"vega", fuzz_seed_vega, fuzz_run_mesh},
    {"tetgen", fuzz_seed_tetgen, fuzz_run_tetgen},    {"body", fuzz_seed_body, fuzz_run_body},
    {"modal", fuzz_seed_modal, fuzz_run_modal},       {"reduced", fuzz_seed_reduced, fuzz_run_reduced},
    {"link", fuzz_seed_link, fuzz_run_link},          {"surface", fuzz_seed_surface, fuzz_run_surface},
    {"vtu", fuzz_seed_vtu, fuzz_run_mesh},            {"inp", fuzz_seed_inp, fuzz_run_mesh}};

#endif
