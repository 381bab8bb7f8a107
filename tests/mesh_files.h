/* mesh_files.h - small mesh files of each format that the library reads, in text and binary, for tests and fuzzers. All
 * hold the same five nodes, a triangle 0 1 2 of region 7 (but Vega and TetGen) and the tets 0 1 2 3 and 1 2 3 4, of two
 * regions.
 *
 *     mesh_file_sample(k, file)   the k-th of them, 0 <= k < MESH_FILES
 */
#ifndef SFEM_TESTS_MESH_FILES_H
#define SFEM_TESTS_MESH_FILES_H

#include <stdint.h>
#include <stdio.h>
#include <string.h>

typedef struct mesh_file {
    unsigned char data[8192];
    size_t n;
    int big; /* high bytes first */
} mesh_file;

static const double mesh_file_x[15] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1};
static const int mesh_file_tets[8] = {0, 1, 2, 3, 1, 2, 3, 4};

static void mesh_file_bytes(mesh_file *f, const void *data, size_t bytes)
{
    memcpy(f->data + f->n, data, bytes);
    f->n += bytes;
}

static void mesh_file_text(mesh_file *f, const char *text) { mesh_file_bytes(f, text, strlen(text)); }

static void mesh_file_bits(mesh_file *f, uint64_t bits, int bytes)
{
    int i;
    for (i = 0; i < bytes; ++i) f->data[f->n++] = (unsigned char)(bits >> 8 * (f->big ? bytes - 1 - i : i));
}

/* Whole numbers from the array, plus base. */
static void mesh_file_ints(mesh_file *f, int count, int bytes, const int *v, int base)
{
    int i;
    for (i = 0; i < count; ++i) mesh_file_bits(f, (uint64_t)(int64_t)(v[i] + base), bytes);
}

static void mesh_file_reals(mesh_file *f, int count, int bytes, const double *x)
{
    int i;
    for (i = 0; i < count; ++i) {
        const float single = (float)x[i];
        uint32_t low;
        uint64_t bits;
        memcpy(&low, &single, 4);
        memcpy(&bits, x + i, 8);
        mesh_file_bits(f, bytes == 4 ? low : bits, bytes);
    }
}

/* What f holds from `at` on becomes base64. */
static void mesh_file_base64(mesh_file *f, size_t at)
{
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    unsigned char raw[4096];
    const size_t n = f->n - at;
    size_t i;
    memcpy(raw, f->data + at, n);
    f->n = at;
    for (i = 0; i < n; i += 3) {
        const uint32_t bits =
            (uint32_t)raw[i] << 16 | (i + 1 < n ? (uint32_t)raw[i + 1] << 8 : 0) | (i + 2 < n ? (uint32_t)raw[i + 2] : 0);
        f->data[f->n++] = (unsigned char)digit[bits >> 18];
        f->data[f->n++] = (unsigned char)digit[bits >> 12 & 63];
        f->data[f->n++] = (unsigned char)(i + 1 < n ? digit[bits >> 6 & 63] : '=');
        f->data[f->n++] = (unsigned char)(i + 2 < n ? digit[bits & 63] : '=');
    }
}

/* One of the arrays of a .vtu with a count of `header` bytes in front: nodes, connectivity, offsets, types, regions. */
static void mesh_file_vtu_array(mesh_file *f, int which, int header)
{
    static const int cells[11] = {0, 1, 2, 3, 0, 1, 2, 1, 2, 3, 4}, offsets[3] = {4, 7, 11}, types[3] = {10, 5, 10},
                     region[3] = {4, 7, 5}, bytes[5] = {15 * 8, 11 * 4, 3 * 8, 3, 3 * 4};
    mesh_file_bits(f, (uint64_t)bytes[which], header);
    switch (which) {
    case 0: mesh_file_reals(f, 15, 8, mesh_file_x); break;
    case 1: mesh_file_ints(f, 11, 4, cells, 0); break;
    case 2: mesh_file_ints(f, 3, 8, offsets, 0); break;
    case 3: mesh_file_ints(f, 3, 1, types, 0); break;
    default: mesh_file_ints(f, 3, 4, region, 0);
    }
}

static void mesh_file_vtu_ascii(mesh_file *f)
{
    mesh_file_text(f, "<?xml version=\"1.0\"?>\n<!-- a > comment <DataArray -->\n"
                      "<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order='LittleEndian'>\n<UnstructuredGrid>\n"
                      "<Piece NumberOfPoints=\"5\" NumberOfCells=\"3\">\n<PointData>\n"
                      "<DataArray type=\"Float64\" Name=\"a &gt; b\" format=\"ascii\">1 2 3 4 nan</DataArray>\n</PointData>\n"
                      "<CellData Scalars=\"region\">\n<DataArray type=\"Int64\" Name=\"region\" format=\"ascii\">\n4 7 5\n"
                      "</DataArray>\n</CellData>\n<Points>\n<DataArray type=\"Float32\" NumberOfComponents=\"3\"\n"
                      " Name=\"Points\" format=\"ascii\">\n0 0 0 1 0 0\n0 1 0 0 0 1\n1e0 1. +.1E+1\n<InformationKey name=\"L2\">\n"
                      "<Value index=\"0\">1</Value></InformationKey></DataArray>\n</Points>\n<Cells>\n"
                      "<DataArray type=\"Int32\" Name=\"connectivity\" format=\"ascii\">0 1 2 3 0 1 2 1 2 3 4</DataArray>\n"
                      "<DataArray type=\"Int32\" Name=\"offsets\" format=\"ascii\">4 7 11</DataArray>\n"
                      "<DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">10 5 10</DataArray>\n"
                      "</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n");
}

/* mode 'b': base64 in place, 'r' raw and appended, 'e' base64 and appended. */
static void mesh_file_vtu(mesh_file *f, char mode, int header)
{
    static const char *const tag[5] = {
        "<Points>\n<DataArray type=\"Float64\" Name=\"Points\" NumberOfComponents=\"3\"",
        "</Points>\n<Cells>\n<DataArray type=\"Int32\" Name=\"connectivity\"", "<DataArray type=\"Int64\" Name=\"offsets\"",
        "<DataArray type=\"UInt8\" Name=\"types\"", "</Cells>\n<CellData>\n<DataArray type=\"Int32\" Name=\"region\""};
    static const int bytes[5] = {15 * 8, 11 * 4, 3 * 8, 3, 3 * 4};
    char text[200];
    int k, offset = 0;
    size_t at;
    sprintf(text, "<VTKFile type=\"UnstructuredGrid\" byte_order=\"%s\" header_type=\"UInt%d\">\n<UnstructuredGrid>\n",
            f->big ? "BigEndian" : "LittleEndian", 8 * header);
    mesh_file_text(f, text);
    mesh_file_text(f, "<Piece NumberOfPoints=\"5\" NumberOfCells=\"3\">\n");
    for (k = 0; k < 5; ++k) {
        mesh_file_text(f, tag[k]);
        if (mode == 'b') {
            mesh_file_text(f, " format=\"binary\">\n ");
            at = f->n;
            mesh_file_vtu_array(f, k, header);
            mesh_file_base64(f, at);
            mesh_file_text(f, "\n</DataArray>\n");
        } else {
            sprintf(text, " format=\"appended\" offset=\"%d\"/>\n", offset);
            mesh_file_text(f, text);
            offset += mode == 'r' ? header + bytes[k] : (header + bytes[k] + 2) / 3 * 4;
        }
    }
    mesh_file_text(f, "</CellData>\n</Piece>\n</UnstructuredGrid>\n");
    if (mode != 'b') {
        mesh_file_text(f, mode == 'r' ? "<AppendedData encoding=\"raw\">\n_" : "<AppendedData encoding=\"base64\">\n _");
        for (k = 0; k < 5; ++k) {
            at = f->n;
            mesh_file_vtu_array(f, k, header);
            if (mode == 'e') mesh_file_base64(f, at);
        }
        mesh_file_text(f, "\n</AppendedData>\n");
    }
    mesh_file_text(f, "</VTKFile>\n");
}

static void mesh_file_vtk_old(mesh_file *f, int binary)
{
    static const int cells[14] = {4, 0, 1, 2, 3, 3, 0, 1, 2, 4, 1, 2, 3, 4}, types[3] = {10, 5, 10}, region[3] = {4, 7, 5};
    f->big = 1;
    mesh_file_text(f, "# vtk DataFile Version 3.0\na title\n");
    mesh_file_text(f, binary ? "BINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n"
                             : "ASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n0 0 0 1 0 0 0 1 0 0 0 1 1 1 1");
    if (binary) mesh_file_reals(f, 15, 4, mesh_file_x);
    mesh_file_text(f, "\nCELLS 3 14\n");
    if (binary)
        mesh_file_ints(f, 14, 4, cells, 0);
    else
        mesh_file_text(f, "4 0 1 2 3\n3 0 1 2\n4 1 2 3 4");
    mesh_file_text(f, "\nCELL_TYPES 3\n");
    if (binary)
        mesh_file_ints(f, 3, 4, types, 0);
    else
        mesh_file_text(f, "10 5 10");
    mesh_file_text(f, "\nPOINT_DATA 5\nVECTORS v float\n");
    if (binary)
        mesh_file_reals(f, 15, 4, mesh_file_x);
    else
        mesh_file_text(f, "0 0 0 0 0 0 0 0 0 0 0 0 0 0 nan");
    mesh_file_text(f, "\nMETADATA\nINFORMATION 0\n\nCELL_DATA 3\nSCALARS CellEntityIds int 1\nLOOKUP_TABLE default\n");
    if (binary)
        mesh_file_ints(f, 3, 4, region, 0);
    else
        mesh_file_text(f, "4 7 5");
    mesh_file_text(f, "\n");
}

static void mesh_file_vtk_new(mesh_file *f)
{
    static const int cells[11] = {0, 1, 2, 3, 0, 1, 2, 1, 2, 3, 4}, offsets[4] = {0, 4, 7, 11}, types[3] = {10, 5, 10},
                     region[3] = {4, 7, 5};
    f->big = 1;
    mesh_file_text(f, "# vtk DataFile Version 5.1\nvtk output\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 double\n");
    mesh_file_reals(f, 15, 8, mesh_file_x);
    mesh_file_text(f, "\nMETADATA\nINFORMATION 0\n\nCELLS 4 11\nOFFSETS vtktypeint64\n");
    mesh_file_ints(f, 4, 8, offsets, 0);
    mesh_file_text(f, "\nCONNECTIVITY vtktypeint64\n");
    mesh_file_ints(f, 11, 8, cells, 0);
    mesh_file_text(f, "\nCELL_TYPES 3\n");
    mesh_file_ints(f, 3, 4, types, 0);
    mesh_file_text(f, "\nCELL_DATA 3\nFIELD FieldData 2\nvolume 1 3 double\n");
    mesh_file_reals(f, 3, 8, mesh_file_x);
    mesh_file_text(f, "\nMETADATA\nINFORMATION 0\n\nmaterial 1 3 unsigned_char\n");
    mesh_file_ints(f, 3, 1, region, 0);
    mesh_file_text(f, "\n");
}

/* The head of a keyword: its number, and the place behind so many bytes of data, of which the count is the first. */
static void mesh_file_medit_keyword(mesh_file *f, int version, int code, int count, int bytes)
{
    const int place = version >= 3 ? 8 : 4, integer = version == 4 ? 8 : 4;
    mesh_file_bits(f, (uint64_t)code, 4);
    mesh_file_bits(f, f->n + (size_t)place + (size_t)(count >= 0 ? integer : 0) + (size_t)bytes, place);
    if (count >= 0) mesh_file_bits(f, (uint64_t)count, integer);
}

static void mesh_file_medit(mesh_file *f, int version)
{
    static const int triangle[4] = {1, 2, 3, 7}, tets[10] = {1, 2, 3, 4, 4, 2, 3, 4, 5, 5};
    const int real = version == 1 ? 4 : 8, integer = version == 4 ? 8 : 4;
    int i;
    mesh_file_bits(f, 1, 4);
    mesh_file_bits(f, (uint64_t)version, 4);
    mesh_file_medit_keyword(f, version, 3, -1, 4);
    mesh_file_bits(f, 3, 4);
    mesh_file_medit_keyword(f, version, 4, 5, 5 * (3 * real + integer));
    for (i = 0; i < 5; ++i) {
        mesh_file_reals(f, 3, real, mesh_file_x + 3 * i);
        mesh_file_bits(f, (uint64_t)(i == 4 ? 3 : 0), integer);
    }
    mesh_file_medit_keyword(f, version, 6, 1, 4 * integer);
    mesh_file_ints(f, 4, integer, triangle, 0);
    mesh_file_medit_keyword(f, version, 14, 1, integer); /* ridges, which are passed over */
    mesh_file_bits(f, 1, integer);
    mesh_file_medit_keyword(f, version, 8, 2, 10 * integer);
    mesh_file_ints(f, 10, integer, tets, 0);
    mesh_file_bits(f, 54, 4);
    mesh_file_bits(f, 0, version >= 3 ? 8 : 4);
}

static const char *const mesh_file_texts[] = {
    /* Abaqus, flat */
    "** a comment\n*HEADING\na title\n*NODE, NSET=ALL\n10, 0., 0., 0.\n11, 1., 0., 0.\n12, 0., 1., 0.\n13, 0., 0., 1.\n"
    "20, 1., 1., 1.\n*Element, type=S3, ELSET=Top\n1, 10, 11, 12\n*ELEMENT, TYPE=C3D4, ELSET=soft\n2, 10, 11, 12, 13\n"
    "*ELEMENT, TYPE=C3D4H, ELSET=hard\n3, 11, 12,\n13, 20\n*NSET, NSET=some\n10, 12,\n20\n*NSET, NSET=odd, GENERATE\n"
    "11, 19, 2\n*NSET, NSET=both\nsome, odd\n*ELSET, ELSET=all, GENERATE\n1, 3\n*MATERIAL, NAME=rubber\n*ELASTIC\n1e6, 0.45\n"
    "*DENSITY\n950.,\n*MATERIAL, NAME=steel\n*ELASTIC, TYPE=ISOTROPIC\n2e11, 0.3\n*SOLID SECTION, ELSET=soft, MATERIAL=rubber\n"
    "1.\n*Solid Section, Elset=HARD, material=Steel\n*STEP\n*STATIC\n*END STEP\n",
    /* Abaqus, a part in an assembly */
    "*Heading\n*Preprint, echo=NO\n*Part, name=Part-1\n*Node\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n5, 1, 1, 1\n"
    "*Element, type=C3D4\n1, 1, 2, 3, 4\n2, 2, 3, 4, 5\n*Elset, elset=\"Set 1\"\n1,\n*Elset, elset=two\n2\n"
    "*Solid Section, elset=\"Set 1\", material=m\n,\n*Solid Section, elset=two, material=m\n,\n*End Part\n*Assembly, name=A\n"
    "*Instance, name=Part-1-1, part=Part-1\n*End Instance\n*Node\n1, 9., 9., 9.\n*Nset, nset=RP\n1,\n*Nset, nset=Fix, instance=Part-1-1\n1, 2,\n 3\n*End Assembly\n"
    "*Material, name=m\n*Density\n1000.\n*Elastic\n1e5, .3\n",
    /* Gmsh 4.1, in three partitions, with names */
    "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n2 7 \"the top\"\n3 4 \"soft\"\n3 5 \"hard\"\n$EndPhysicalNames\n"
    "$Entities\n0 0 1 2\n1 0 0 0 1 1 0 1 7 0\n1 0 0 0 1 1 1 1 4 1 1\n2 0 0 0 1 1 1 1 5 0\n$EndEntities\n"
    "$PartitionedEntities\n2\n1\n9 1\n0 0 1 2\n12 2 1 1 1 0 0 0 1 1 0 1 7 0\n13 3 1 1 1 0 0 0 1 1 1 1 4 1 12\n"
    "14 3 2 2 1 2 0 0 0 1 1 1 2 5 4 0\n$EndPartitionedEntities\n$Nodes\n1 5 1 5\n3 13 0 5\n1\n2\n3\n4\n5\n0 0 0\n1 0 0\n0 1 0\n"
    "0 0 1\n1 1 1\n$EndNodes\n$Elements\n3 3 1 3\n2 12 2 1\n1 1 2 3\n3 13 4 1\n2 1 2 3 4\n3 14 4 1\n3 2 3 4 5\n$EndElements\n"
    "$GhostElements\n1\n2 1 1 2\n$EndGhostElements\n",
    /* Gmsh 2.2, with names; the second tet is in two groups */
    "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n2 7 \"the top\"\n3 4 \"soft\"\n3 5 \"hard\"\n$EndPhysicalNames\n"
    "$Nodes\n5\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 1\n$EndNodes\n$Elements\n4\n1 2 2 7 1 1 2 3\n2 4 2 4 1 1 2 3 4\n"
    "3 4 4 5 2 1 1 2 3 4 5\n4 4 2 4 2 2 3 4 5\n$EndElements\n",
    /* Medit */
    "MeshVersionFormatted 2\nDimension 3\nVertices 5\n0 0 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n1 1 1 3\nTriangles 1\n1 2 3 7\n"
    "Tetrahedra 2\n1 2 3 4 4\n2 3 4 5 5\nEnd\n",
    /* Vega */
    "*VERTICES\n5 3 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 1\n*ELEMENTS\nTET\n2 4 0\n1 1 2 3 4\n2 2 3 4 5\n"
    "*MATERIAL rubber\nENU, 950, 1e6, 0.45\n*MATERIAL steel\nENU, 7800, 2e11, 0.3\n*SET hard\n2\n*REGION\nallElements, rubber\n"
    "*REGION\nhard, steel\n"};

enum { MESH_FILE_TEXTS = 6, MESH_FILES = 11 + MESH_FILE_TEXTS };

static const char *mesh_file_sample(int k, mesh_file *f)
{
    f->n = 0;
    f->big = 0;
    switch (k) {
    case 0: mesh_file_vtu_ascii(f); return "VTU, ASCII";
    case 1: mesh_file_vtu(f, 'b', 4); return "VTU, base64";
    case 2: f->big = 1; mesh_file_vtu(f, 'r', 8); return "VTU, raw";
    case 3: mesh_file_vtu(f, 'e', 8); return "VTU, appended base64";
    case 4: mesh_file_vtk_old(f, 0); return "VTK 3.0, ASCII";
    case 5: mesh_file_vtk_old(f, 1); return "VTK 3.0, binary";
    case 6: mesh_file_vtk_new(f); return "VTK 5.1, binary";
    case 7: mesh_file_medit(f, 1); return "Medit 1, binary";
    case 8: f->big = 1; mesh_file_medit(f, 2); return "Medit 2, binary";
    case 9: mesh_file_medit(f, 3); return "Medit 3, binary";
    case 10: f->big = 1; mesh_file_medit(f, 4); return "Medit 4, binary";
    default: mesh_file_text(f, mesh_file_texts[k - 11]); return mesh_file_texts[k - 11];
    }
}

#endif
