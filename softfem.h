/* softfem.h - elastic bodies in one C header.                                          v0.1.0
 *
 * Tetrahedral finite elements for real-time and offline use: put this file into a project, and in
 * exactly one source file write
 *
 *     #define SOFTFEM_IMPLEMENTATION
 *     #include "softfem.h"
 *
 * Every other file includes it without the define. It needs a C99 or C++11 compiler and libm, and
 * nothing else; OpenMP is used where it is compiled in. Public domain or MIT, at your choice: see the
 * end of the file.
 *
 * THE PIPELINE, which is also the order of the implementation below
 *
 *     sfem_mesh    nodes and tets: generated, read from a file, or given as arrays
 *     sfem_model   mesh + materials -> K, M, D on one sparsity pattern; never changes, shared
 *     sfem_factor  L D L^T of A = r M + (q/2) h D + p h^2 K: made when first needed, shared, counted
 *     sfem_body    what moves: state, pins, handles, integrator; one block of it can be saved
 *
 * A program of 15 lines is examples/hello.c.
 *
 * CONTENTS (search for the marker)
 *
 *     API    >>api-base     status, errors, memory, threads       >>api-mesh    >>api-meshio
 *            >>api-matrix   sparse and dense matrices, solvers    >>api-model   >>api-body
 *     IMPL   >>base         status, allocation, threads, vector paths
 *            >>math         3-vectors, 3x3 matrices, small dense systems
 *            >>mesh         tets, surface, generators, checks, renumbering
 *            >>meshio       readers and writers (left out by SFEM_NO_STDIO)
 *            >>sparse       3x3-block matrices, ordering, LDL^T, dense, conjugate gradients
 *            >>element      linear tetrahedron
 *            >>fem          assembly, mass, damping, loads, stress
 *            >>factor       the shared factor of a body's system matrix
 *            >>handle       pins and handles set, moved and released while the body runs
 *            >>newmark      implicit Newmark          >>pqr  the (p,q,r) family, central difference
 *            >>body         the pipeline that a user calls: create, prepare, step, read
 *     TAIL   licence, changes
 *
 * UNITS are the caller's, as long as they are consistent; the comments say SI (m, kg, s, N, Pa).
 *
 * SWITCHES, all to be defined the same way in every file that includes the header
 *
 *     SFEM_STATIC        every function static: the whole library inside one source file
 *     SFEM_ASSERT(x)     what to do about misuse of the interface; default assert(x)
 *     SFEM_NO_STDIO      leave the readers and writers out
 *     SFEM_NO_DISPATCH   portable kernels only, whatever the processor offers
 *
 * LIMITS. Linear (4-node) tetrahedra. Node and tet counts below 2^31. No contact, no remeshing.
 */
#ifndef SOFTFEM_H
#define SOFTFEM_H

#include <stddef.h>
#include <stdint.h>

#define SFEM_VERSION_MAJOR 0
#define SFEM_VERSION_MINOR 1
#define SFEM_VERSION_PATCH 0
#define SFEM_VERSION (SFEM_VERSION_MAJOR * 10000 + SFEM_VERSION_MINOR * 100 + SFEM_VERSION_PATCH)

#ifdef SFEM_STATIC
#if defined(__GNUC__)
#define SFEM_DEF static __attribute__((unused))
#else
#define SFEM_DEF static
#endif
#else
#define SFEM_DEF extern
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* ============================================================================================
 * >>api-base   status, errors, memory, threads
 * ============================================================================================ */

typedef double sfem_real; /* one real type */
typedef int32_t sfem_int; /* one signed index type; offsets into factors are size_t */

/* What can go wrong at run time. A function that returns anything but SFEM_OK has left its objects
 * as they were and its outputs unset. What only a wrong program can do (a NULL object, an object that
 * was freed) trips SFEM_ASSERT instead. */
#define SFEM_STATUS_LIST(X)                                                                          \
    X(SFEM_OK, "ok")                                                                                 \
    X(SFEM_BAD_ARGUMENT, "an argument is out of its range")                                          \
    X(SFEM_BAD_MESH, "the mesh cannot be used as it is")                                             \
    X(SFEM_NOT_FINITE, "a number is not finite")                                                     \
    X(SFEM_NOT_SPD, "the matrix is not positive definite")                                           \
    X(SFEM_SINGULAR, "the matrix is singular")                                                       \
    X(SFEM_UNSTABLE, "the step is beyond the stability limit")                                       \
    X(SFEM_NOT_CONVERGED, "the iteration did not converge")                                          \
    X(SFEM_NOT_PREPARED, "prepare the body first: allocation is forbidden here")                     \
    X(SFEM_FULL, "a fixed capacity is used up")                                                      \
    X(SFEM_TOO_LARGE, "an index or a size would overflow")                                           \
    X(SFEM_OUT_OF_MEMORY, "out of memory")                                                           \
    X(SFEM_IO, "a file could not be read or written")                                                \
    X(SFEM_FORMAT, "the data is not in the format it claims")                                        \
    X(SFEM_MISMATCH, "two objects do not belong together")

typedef enum sfem_status {
#define SFEM_STATUS_ENUM(name, text) name,
    SFEM_STATUS_LIST(SFEM_STATUS_ENUM)
#undef SFEM_STATUS_ENUM
    SFEM_STATUS_COUNT
} sfem_status;

SFEM_DEF const char *sfem_status_text(sfem_status status); /* a constant sentence, never NULL */

/* Where it went wrong. Functions that can fail take a pointer to one, or NULL; it is written only on
 * failure. The text is one sentence that names the thing. */
typedef struct sfem_error {
    sfem_status status;
    sfem_int node, tet, line; /* the place, 0-based (lines 1-based); -1 where it does not apply */
    char text[240];
} sfem_error;

/* Memory. All zero means malloc and free. The functions may be called from the thread that calls the
 * library, never from its parallel tasks. */
typedef struct sfem_allocator {
    void *(*allocate)(size_t bytes, void *user); /* NULL on failure; aligned as malloc does */
    void (*release)(void *memory, void *user);
    void *user;
} sfem_allocator;

/* Threads. All zero means the calling thread alone. With threads > 1, loops are split with OpenMP
 * where it is compiled in, or with parallel_for where that is given: it has to call
 * task(data, i) once for each i in [0, count), in any order, on any threads, and return when all are
 * done. Results have the same bits for any number of threads. */
typedef void (*sfem_task)(void *data, sfem_int index);
typedef struct sfem_exec {
    sfem_int threads;
    void (*parallel_for)(sfem_int count, sfem_task task, void *data, void *user);
    void *user;
} sfem_exec;

/* ============================================================================================
 * >>api-mesh   tetrahedral meshes
 * ============================================================================================ */

/* A mesh owns its arrays; sfem_mesh_free releases them. A mesh may also point at the caller's
 * arrays (fill the fields, do not free it). Tets a b c d are right-handed: (b-a)x(c-a).(d-a) > 0 */
typedef struct sfem_mesh {
    sfem_int nodes, tets;
    sfem_real *x;     /* [nodes][3] rest positions, m */
    sfem_int *tet;    /* [tets][4]  node numbers, from 0 */
    sfem_int *region; /* [tets]     the file's region or physical group, or NULL */
    sfem_allocator allocator;
} sfem_mesh;

/* MAKING ONE. All of these fill *out, whatever it held; sfem_mesh_free it afterwards. They allocate
 * through `allocator` (NULL = malloc), which the mesh remembers.
 *   errors  SFEM_BAD_ARGUMENT   a count below 1, a length that is not above 0 and finite
 *           SFEM_TOO_LARGE      more nodes or tets than an sfem_int can number
 *           SFEM_OUT_OF_MEMORY */

typedef enum sfem_block_cells {
    SFEM_CELL_5_TETS, /* cells and their mirror images alternate; quality .77 and 1 on cubes */
    SFEM_CELL_6_TETS  /* Kuhn 1960: six equal tets round one diagonal; quality .65 on cubes */
} sfem_block_cells;

/* A box with one corner at the origin, cells[0] x cells[1] x cells[2] cells of 5 or 6 tets each.
 * Node (i,j,k) is number (i (cells[1]+1) + j) (cells[2]+1) + k. */
SFEM_DEF sfem_status sfem_mesh_block(const sfem_int cells[3], const sfem_real size[3],
                                     sfem_block_cells kind, const sfem_allocator *allocator,
                                     sfem_mesh *out, sfem_error *err);

/* A cylinder round the x axis, from x = 0 to x = length: 3 rings (rings+1) + 1 nodes in each of
 * layers+1 cross-sections, 18 rings^2 layers tets; the rim is a polygon of 6 rings sides. Nodes are
 * numbered section by section. Quality > .55 where length/layers = radius/rings. */
SFEM_DEF sfem_status sfem_mesh_cylinder(sfem_real radius, sfem_real length, sfem_int rings,
                                        sfem_int layers, const sfem_allocator *allocator,
                                        sfem_mesh *out, sfem_error *err);

/* A ball about the origin in 20 rings^3 tets: concentric icosahedral shells of 10 r^2 + 2 nodes,
 * r = 1 .. rings, round node 0; the surface is a geodesic sphere, its nodes on the sphere.
 * Quality > .53, .82 in the mean. */
SFEM_DEF sfem_status sfem_mesh_ball(sfem_real radius, sfem_int rings,
                                    const sfem_allocator *allocator, sfem_mesh *out,
                                    sfem_error *err);

/* A copy of arrays: x [nodes][3], m; tet [tets][4], node numbers from 0. Left-handed tets are
 * turned as by sfem_mesh_orient; anything else that sfem_mesh_check objects to is refused with its
 * status. */
SFEM_DEF sfem_status sfem_mesh_copy(sfem_int nodes, const sfem_real *x, sfem_int tets,
                                    const sfem_int *tet, const sfem_allocator *allocator,
                                    sfem_mesh *out, sfem_error *err);

/* Releases the arrays; all zero afterwards. NULL, an all-zero mesh and a second call do nothing. */
SFEM_DEF void sfem_mesh_free(sfem_mesh *mesh);

/* CHECKING. The quality of a tet is q = 6 sqrt(2) V / l^3, V its signed volume and l the root mean
 * square of its six edges [Parthasarathy, Graichen, Hathaway 1994; the 3/2nd power of the mean
 * ratio of Liu, Joe 1994]: 1 for the regular tet, 0 for a flat one, negative for an inverted one,
 * the same at any scale. A tet counts as flat where |q| < 1e-12: its stiffness would be rounding
 * error. */
typedef struct sfem_mesh_report {
    /* faults: a mesh with one of these cannot be used */
    sfem_int not_finite;   /* nodes with a NaN or infinite coordinate */
    sfem_int out_of_range; /* tets that name a node that is not there */
    sfem_int repeated;     /* tets that name a node twice */
    sfem_int flat;         /* tets without volume */
    sfem_int inverted;     /* left-handed tets */
    /* suspicious, but usable */
    sfem_int unused;      /* nodes in no tet */
    sfem_int coincident;  /* nodes at the very place of one with a lower number: a seam? */
    sfem_int overlapping; /* faces with two tets on one side: tets twice, or through one another */
    /* shape, over the tets without a fault of the first three kinds */
    sfem_real volume, min_volume, max_volume; /* m^3, signed */
    sfem_real min_quality, mean_quality;      /* see above */
    sfem_int worst_tet;                       /* has min_quality; -1 if there is none */
    sfem_real min_edge, max_edge;             /* m */
    sfem_real box[2][3];                      /* m, of the finite nodes in use or not */
    /* topology; -1 each where out_of_range or repeated is not 0 */
    sfem_int components; /* parts that share no node */
    sfem_int surface_triangles, surface_edges, surface_nodes;
    sfem_int euler; /* surface nodes - edges + triangles: 2 for a ball, 0 for a ring */
} sfem_mesh_report;

/* Can this mesh be used? SFEM_OK, or the first fault, by number, in a sentence: an empty mesh, a
 * coordinate that is not finite, then the lowest tet with any of the faults above.
 *   report  NULL, or filled in, also for a mesh with faults; not where memory ran out
 *   errors  SFEM_BAD_MESH, SFEM_NOT_FINITE; with a report also SFEM_OUT_OF_MEMORY, SFEM_TOO_LARGE
 *   cost    O(nodes + tets); allocates only for the report */
SFEM_DEF sfem_status sfem_mesh_check(const sfem_mesh *mesh, sfem_mesh_report *report,
                                     sfem_error *err);

/* Swaps the last two nodes of every left-handed tet; returns how many. Allocates nothing. */
SFEM_DEF sfem_int sfem_mesh_orient(sfem_mesh *mesh);

/* The boundary: the faces with a tet on one side only, counterclockwise seen from outside (for
 * right-handed tets), in the order of their tets. It is closed: each edge is used as often in one
 * direction as in the other, even where the mesh overlaps itself.
 *   errors  SFEM_BAD_MESH (node number out of range), SFEM_TOO_LARGE (2^29 tets),
 *           SFEM_OUT_OF_MEMORY
 *   cost    O(nodes + tets) */
typedef struct sfem_surface {
    sfem_int triangles;
    sfem_int *tri; /* [triangles][3] node numbers of the mesh */
    sfem_int *tet; /* [triangles]    the tet behind each */
    sfem_allocator allocator;
} sfem_surface;
SFEM_DEF sfem_status sfem_mesh_surface(const sfem_mesh *mesh, const sfem_allocator *allocator,
                                       sfem_surface *out, sfem_error *err);
SFEM_DEF void sfem_surface_free(sfem_surface *surface); /* as sfem_mesh_free */

/* Parts that share no node with one another, numbered from 0 by their lowest nodes: label[i] is the
 * part of node i, -1 if no tet uses it. count may be NULL. SFEM_BAD_MESH for a node number out of
 * range. O(nodes + tets) in practice [union-find with path halving, Tarjan, van Leeuwen 1984];
 * allocates nothing. */
SFEM_DEF sfem_status sfem_mesh_components(const sfem_mesh *mesh, sfem_int *label, sfem_int *count,
                                          sfem_error *err);

/* NUMBERING. Renumbers the nodes in reverse Cuthill-McKee order of the node graph [Cuthill, McKee
 * 1969; start nodes of George, Liu 1979], unused ones last, and sorts the tets by their lowest
 * nodes, with their regions: neighbours in space become neighbours in memory.
 *   new_of_old  [nodes], or NULL: the new number of each node
 *   errors      as sfem_mesh_surface; the mesh is then as it was
 *   cost        O(nodes + tets); scratch from the mesh's allocator */
SFEM_DEF sfem_status sfem_mesh_renumber(sfem_mesh *mesh, sfem_int *new_of_old, sfem_error *err);

/* The largest difference of two node numbers in one tet. */
SFEM_DEF sfem_int sfem_mesh_bandwidth(const sfem_mesh *mesh);

/* Takes the nodes out that no tet uses; the others keep their order, the arrays their place.
 *   new_of_old  [nodes before], or NULL: the new number of each node, -1 if it is gone
 *   errors      SFEM_BAD_MESH, SFEM_OUT_OF_MEMORY; the mesh is then as it was */
SFEM_DEF sfem_status sfem_mesh_remove_unused(sfem_mesh *mesh, sfem_int *new_of_old,
                                             sfem_error *err);

/* PICKING, in a mesh that passed sfem_mesh_check, at current positions x [nodes][3] (NULL = rest).
 * Both return 1 and fill the outputs (any may be NULL), or return 0 and leave them. bary [4] is
 * >= 0 and sums to 1: the point is sum_i bary[i] x[tet[i]]. Tets that are flat in x are passed
 * over, inverted ones are not. O(tets); nothing is allocated. */

/* The first tet that a ray enters, or the one that it starts in (distance 0). The direction is of
 * any length above 0; the point is origin + distance direction/|direction|. */
SFEM_DEF int sfem_mesh_pick_ray(const sfem_mesh *mesh, const sfem_real *x,
                                const sfem_real origin[3], const sfem_real direction[3],
                                sfem_int *tet, sfem_real bary[4], sfem_real *distance);

/* The tet that contains a point. Outside of all tets it returns 0: there is no nearest. */
SFEM_DEF int sfem_mesh_locate(const sfem_mesh *mesh, const sfem_real *x, const sfem_real point[3],
                              sfem_int *tet, sfem_real bary[4]);

/* ============================================================================================
 * >>api-meshio   files
 * ============================================================================================ */

/* READING. Which format it is shows in the data itself:
 *   Gmsh 4.1 ASCII (.msh)    node tags in any order and with gaps; 4-node tets (type 4); region is
 *                            the volume's first physical group (0 without one) if any volume has
 *                            one, else the number of its entity
 *   VTK legacy ASCII (.vtk)  unstructured grids of versions 1.0 to 5.1; tets (type 10); no region
 * Cells of other types are skipped. Nodes stand in the file's order, numbered from 0, with those
 * that no tet uses (sfem_mesh_remove_unused takes them out). Left-handed tets are turned, as by
 * sfem_mesh_orient; flat ones and the like are left for sfem_mesh_check to find. Numbers are read
 * exactly, whatever the locale: the double nearest to the text.
 *   errors  SFEM_FORMAT      another format or version, or not what the format says; err->line
 *           SFEM_BAD_MESH    a tet that names a node that is not there (err->line), no tets at all
 *           SFEM_NOT_FINITE  a coordinate that is NaN or infinite, or overflows; err->line
 *           SFEM_TOO_LARGE, SFEM_OUT_OF_MEMORY, and for a file SFEM_IO
 *   cost    O(bytes). Memory follows the data that is there, not the counts that it claims. */

/* From memory; the text needs no terminating 0. */
SFEM_DEF sfem_status sfem_mesh_parse(const void *data, size_t bytes,
                                     const sfem_allocator *allocator, sfem_mesh *out,
                                     sfem_error *err);

#ifndef SFEM_NO_STDIO
/* From a file, which is read whole. */
SFEM_DEF sfem_status sfem_mesh_read(const char *path, const sfem_allocator *allocator,
                                    sfem_mesh *out, sfem_error *err);

/* WRITING. Text has a decimal point in any locale, and as many digits (15 or 17) as bring the same
 * double back. A file that exists is overwritten; SFEM_IO tells if it could not be opened or not be
 * written to the end (the disk is full), and what is there of it then is useless. */

/* Gmsh 4.1 ASCII, regions as entity numbers: sfem_mesh_read gives the same mesh again. */
SFEM_DEF sfem_status sfem_write_msh(const char *path, const sfem_mesh *mesh, sfem_error *err);

/* Values at nodes or in tets, to be written next to the mesh. */
typedef struct sfem_field {
    const char *name;
    const sfem_real *values; /* [nodes or tets][components] */
    sfem_int components;     /* 1 scalar, 3 vector, 6 or 9 tensor: xx yy zz xy yz xz, or by rows */
    int per_tet;
} sfem_field;

/* VTK XML unstructured grid (.vtu, for ParaView): doubles, in binary.
 *   x       [nodes][3] current positions, m; NULL = rest
 *   fields  [count], may be NULL if count is 0; the mesh's regions are added by themselves
 *   errors  SFEM_BAD_ARGUMENT (a field without name or values, components < 1), SFEM_IO */
SFEM_DEF sfem_status sfem_write_vtu(const char *path, const sfem_mesh *mesh, const sfem_real *x,
                                    const sfem_field *fields, sfem_int count, sfem_error *err);

/* ParaView's list (.pvd) of .vtu files, relative to it, and their times, s. */
SFEM_DEF sfem_status sfem_write_pvd(const char *path, const char *const *files,
                                    const sfem_real *times, sfem_int count, sfem_error *err);

/* Wavefront OBJ of a surface at positions x (NULL = rest): only the nodes on it, in mesh order.
 * surface NULL = the mesh's own. Scratch from the mesh's allocator: SFEM_OUT_OF_MEMORY. */
SFEM_DEF sfem_status sfem_write_obj(const char *path, const sfem_mesh *mesh,
                                    const sfem_surface *surface, const sfem_real *x,
                                    sfem_error *err);
#endif

/* ============================================================================================
 * >>api-matrix   symmetric matrices of 3x3 blocks, and what solves with them
 * ============================================================================================ */

/* A symmetric matrix of n x n blocks of 3x3, of which the lower half is stored by rows: block k,
 * row[i] <= k < row[i+1], stands in block row i and block column col[k] <= i; columns ascend, so the
 * diagonal block, which is always there, is the last of its row. A diagonal block is stored whole. */
typedef struct sfem_matrix {
    sfem_int n;
    const sfem_int *row; /* [n+1] */
    const sfem_int *col; /* [row[n]] */
    sfem_real *val;      /* [row[n]][3][3], row-major blocks */
} sfem_matrix;

/* ============================================================================================
 * >>api-model   finite elements: K, M, D, loads, stress
 * ============================================================================================ */

/* ============================================================================================
 * >>api-body   a body that moves
 * ============================================================================================ */

#ifdef __cplusplus
}
#endif
#endif /* SOFTFEM_H */

/* ============================================================================================ */
#if defined(SOFTFEM_IMPLEMENTATION) && !defined(SFEMI_IMPLEMENTED)
#define SFEMI_IMPLEMENTED

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifndef SFEM_ASSERT
#include <assert.h>
#define SFEM_ASSERT(x) assert(x)
#endif
#ifdef _OPENMP
#include <omp.h>
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* ============================================================================================
 * >>base   status, allocation, threads
 * ============================================================================================ */

#if defined(__GNUC__)
#define SFEMI_PRINTF(f, first) __attribute__((format(printf, f, first)))
#define SFEMI_UNUSED __attribute__((unused))
#define SFEMI_RESTRICT __restrict__
#else
#define SFEMI_PRINTF(f, first)
#define SFEMI_UNUSED
#define SFEMI_RESTRICT
#endif

#define SFEMI_ALIGN 64 /* a cache line, and the widest vector */

SFEM_DEF const char *sfem_status_text(sfem_status status)
{
    static const char *const text[] = {
#define SFEMI_STATUS_TEXT(name, sentence) sentence,
        SFEM_STATUS_LIST(SFEMI_STATUS_TEXT)
#undef SFEMI_STATUS_TEXT
    };
    return (unsigned)status < (unsigned)SFEM_STATUS_COUNT ? text[status] : "unknown status";
}

/* Fills *err, if any, and returns the status: every failure leaves through here. */
SFEMI_PRINTF(5, 6)
static sfem_status sfemi_fail_at(sfem_error *err, sfem_status status, sfem_int node, sfem_int tet,
                                 const char *format, ...)
{
    if (err) {
        va_list list;
        err->status = status;
        err->node = node;
        err->tet = tet;
        err->line = -1;
        va_start(list, format);
        vsnprintf(err->text, sizeof err->text, format, list);
        va_end(list);
    }
    return status;
}

#define sfemi_fail(err, status, ...) sfemi_fail_at(err, status, -1, -1, __VA_ARGS__)

/* Finite? From the bits, because -ffast-math lets a compiler drop x != x and isfinite(x). */
static int sfemi_finite(sfem_real x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (bits & 0x7ff0000000000000u) != 0x7ff0000000000000u;
}

static SFEMI_UNUSED int sfemi_all_finite(const sfem_real *x, size_t count)
{
    size_t i;
    for (i = 0; i < count; ++i)
        if (!sfemi_finite(x[i])) return 0;
    return 1;
}

/* Zeroed, aligned memory for count things of the given size; NULL on failure or overflow. The
 * allocator's own pointer stands just before the block. */
static void *sfemi_new(const sfem_allocator *a, size_t count, size_t size)
{
    const size_t extra = SFEMI_ALIGN + sizeof(void *);
    size_t bytes, start;
    char *raw;
    if (size && count > ((size_t)-1 - extra) / size) return NULL;
    bytes = count * size + extra;
    raw = (char *)(a->allocate ? a->allocate(bytes, a->user) : malloc(bytes));
    if (!raw) return NULL;
    start = extra - (size_t)((uintptr_t)raw + extra) % SFEMI_ALIGN;
    memset(raw + start, 0, count * size);
    memcpy(raw + start - sizeof(void *), &raw, sizeof(void *));
    return raw + start;
}

static void sfemi_delete(const sfem_allocator *a, void *memory)
{
    void *raw;
    if (!memory) return;
    memcpy(&raw, (char *)memory - sizeof(void *), sizeof(void *));
    if (a->release) a->release(raw, a->user);
    else free(raw);
}

/* p = new array of count elements of type T, or goto done with status set: the allocating functions
 * of this file have locals `status`, `err` and one exit. */
#define SFEMI_NEW(T, p, allocator, count)                                                            \
    do {                                                                                             \
        (p) = (T *)sfemi_new((allocator), (size_t)(count), sizeof(T));                               \
        if (!(p)) {                                                                                  \
            status = sfemi_fail(err, SFEM_OUT_OF_MEMORY, "out of memory: %s", #p);                   \
            goto done;                                                                               \
        }                                                                                            \
    } while (0)
#define SFEMI_TRY(call)                                                                              \
    do {                                                                                             \
        status = (call);                                                                             \
        if (status != SFEM_OK) goto done;                                                            \
    } while (0)

static sfem_int sfemi_threads(const sfem_exec *e)
{
    if (!e || e->threads <= 1) return 1;
#ifndef _OPENMP
    if (!e->parallel_for) return 1;
#endif
    return e->threads;
}

/* Calls task(data, i) for each i in [0, count). */
static void sfemi_run(const sfem_exec *e, sfem_int count, sfem_task task, void *data)
{
    sfem_int i;
    if (count > 1 && sfemi_threads(e) > 1) {
        if (e->parallel_for) {
            e->parallel_for(count, task, data, e->user);
            return;
        }
#ifdef _OPENMP
#pragma omp parallel for num_threads(e->threads) schedule(dynamic, 1)
        for (i = 0; i < count; ++i) task(data, i);
        return;
#endif
    }
    for (i = 0; i < count; ++i) task(data, i);
}

/* ============================================================================================
 * >>math   3-vectors, 3x3 matrices (row-major), small dense systems
 * ============================================================================================ */

static SFEMI_UNUSED sfem_real sfemi_dot3(const sfem_real *a, const sfem_real *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static SFEMI_UNUSED void sfemi_cross(const sfem_real *a, const sfem_real *b, sfem_real *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static SFEMI_UNUSED void sfemi_sub3(const sfem_real *a, const sfem_real *b, sfem_real *c)
{
    c[0] = a[0] - b[0];
    c[1] = a[1] - b[1];
    c[2] = a[2] - b[2];
}

/* Six times the signed volume of the tet a b c d. */
static SFEMI_UNUSED sfem_real sfemi_volume6(const sfem_real *a, const sfem_real *b,
                                            const sfem_real *c, const sfem_real *d)
{
    sfem_real u[3], v[3], w[3], n[3];
    sfemi_sub3(b, a, u);
    sfemi_sub3(c, a, v);
    sfemi_sub3(d, a, w);
    sfemi_cross(u, v, n);
    return sfemi_dot3(n, w);
}

/* ============================================================================================
 * >>mesh   tets, surface, generators, checks, renumbering
 * ============================================================================================ */

/* Invariants: a tet is right-handed once sfem_mesh_orient or a generator has been over it;
 * everything runs in O(nodes + tets), by counting sorts instead of hashing, so that no input is
 * slow.
 *
 * LITERATURE. Kuhn, Some combinatorial lemmas in topology, IBM J. Res. Dev. 4, 1960. Dompierre,
 * Labbe, Vallet, Camarero, How to subdivide pyramids, prisms and hexahedra into tetrahedra, 8th
 * Int. Meshing Roundtable, 1999. Parthasarathy, Graichen, Hathaway, A comparison of tetrahedron
 * quality measures, Finite Elem. Anal. Des. 15, 1994. Cuthill, McKee, Reducing the bandwidth of
 * sparse symmetric matrices, Proc. 24th ACM Nat. Conf., 1969. George, Liu, An implementation of a
 * pseudoperipheral node finder, ACM Trans. Math. Softw. 5, 1979. Tarjan, van Leeuwen, Worst-case
 * analysis of set union algorithms, J. ACM 31, 1984. */

/* ---- memory ---- */

SFEM_DEF void sfem_mesh_free(sfem_mesh *mesh)
{
    if (!mesh) return;
    sfemi_delete(&mesh->allocator, mesh->x);
    sfemi_delete(&mesh->allocator, mesh->tet);
    sfemi_delete(&mesh->allocator, mesh->region);
    memset(mesh, 0, sizeof *mesh);
}

/* Arrays for a new mesh. The counts come as doubles, which hold any product that a caller can ask
 * for without overflow. */
static sfem_status sfemi_mesh_new(double nodes, double tets, const sfem_allocator *allocator,
                                  sfem_mesh *out, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfem_mesh m;
    memset(&m, 0, sizeof m);
    if (allocator) m.allocator = *allocator;
    if (nodes > (double)INT32_MAX || tets > (double)INT32_MAX)
        return sfemi_fail(err, SFEM_TOO_LARGE, "%.0f nodes and %.0f tets: at most 2^31 - 1 of each",
                          nodes, tets);
    m.nodes = (sfem_int)(nodes + 0.5); /* -ffast-math divides inexactly */
    m.tets = (sfem_int)(tets + 0.5);
    SFEMI_NEW(sfem_real, m.x, &m.allocator, 3 * (size_t)m.nodes);
    SFEMI_NEW(sfem_int, m.tet, &m.allocator, 4 * (size_t)m.tets);
    *out = m;
done:
    if (status != SFEM_OK) sfem_mesh_free(&m);
    return status;
}

/* ---- generators ---- */

static sfem_status sfemi_mesh_counts_and_sizes(const char *what, const sfem_int *count, int counts,
                                               const sfem_real *size, int sizes, sfem_error *err)
{
    int i;
    for (i = 0; i < counts; ++i)
        if (count[i] < 1)
            return sfemi_fail(err, SFEM_BAD_ARGUMENT, "%s: count %d is %ld, below 1", what, i,
                              (long)count[i]);
    for (i = 0; i < sizes; ++i)
        if (!sfemi_finite(size[i]) || size[i] <= 0)
            return sfemi_fail(err, SFEM_BAD_ARGUMENT, "%s: length %d is %g, not above 0 and finite",
                              what, i, size[i]);
    return SFEM_OK;
}

/* Writes tet number *count, right-handed, and counts it. */
static void sfemi_mesh_put(sfem_mesh *m, sfem_int *count, sfem_int a, sfem_int b, sfem_int c,
                           sfem_int d)
{
    const sfem_real *x = m->x;
    sfem_int *t = m->tet + 4 * (size_t)(*count)++;
    int left = sfemi_volume6(x + 3 * (size_t)a, x + 3 * (size_t)b, x + 3 * (size_t)c,
                             x + 3 * (size_t)d) < 0;
    t[0] = a;
    t[1] = b;
    t[2] = left ? d : c;
    t[3] = left ? c : d;
}

/* The six orders of three axes, as bits: each is a walk from corner 0 of a cube to corner 7. */
static const unsigned char sfemi_mesh_walk[6][3] = {{1, 2, 4}, {1, 4, 2}, {2, 1, 4},
                                                    {2, 4, 1}, {4, 1, 2}, {4, 2, 1}};

/* node[n]: the corners of a cell; bits 4, 2, 1 of n step along i, j, k. Five tets: a corner is cut
 * off where i+j+k is odd in the whole grid, so that neighbours draw the same diagonal on their
 * face. */
static void sfemi_mesh_cell(sfem_mesh *m, sfem_int *count, const sfem_int node[8], int odd,
                            sfem_block_cells kind)
{
    int n, keep = odd ? 1 : 0; /* of the even corners 0 3 5 6 or the odd ones 7 4 2 1 */
    if (kind == SFEM_CELL_6_TETS) {
        for (n = 0; n < 6; ++n) {
            const unsigned char *w = sfemi_mesh_walk[n];
            sfemi_mesh_put(m, count, node[0], node[w[0]], node[w[0] | w[1]], node[7]);
        }
        return;
    }
    for (n = 0; n < 8; ++n)
        if ((((n >> 2) + (n >> 1) + n) & 1) != keep)
            sfemi_mesh_put(m, count, node[n], node[n ^ 1], node[n ^ 2], node[n ^ 4]);
    if (keep)
        sfemi_mesh_put(m, count, node[7], node[4], node[2], node[1]);
    else
        sfemi_mesh_put(m, count, node[0], node[3], node[5], node[6]);
}

SFEM_DEF sfem_status sfem_mesh_block(const sfem_int cells[3], const sfem_real size[3],
                                     sfem_block_cells kind, const sfem_allocator *allocator,
                                     sfem_mesh *out, sfem_error *err)
{
    sfem_status status;
    sfem_mesh m;
    sfem_int i, j, k, count = 0;
    double nx, ny, nz;
    SFEM_ASSERT(cells && size && out);
    if (kind != SFEM_CELL_5_TETS && kind != SFEM_CELL_6_TETS)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "block: unknown kind of cell %d", (int)kind);
    status = sfemi_mesh_counts_and_sizes("block", cells, 3, size, 3, err);
    if (status != SFEM_OK) return status;
    nx = cells[0], ny = cells[1], nz = cells[2];
    status = sfemi_mesh_new((nx + 1) * (ny + 1) * (nz + 1),
                            (kind == SFEM_CELL_5_TETS ? 5 : 6) * nx * ny * nz, allocator, &m, err);
    if (status != SFEM_OK) return status;
    for (i = 0; i <= cells[0]; ++i)
        for (j = 0; j <= cells[1]; ++j)
            for (k = 0; k <= cells[2]; ++k) {
                sfem_real *x =
                    m.x +
                    3 * ((size_t)(i * (cells[1] + 1) + j) * (size_t)(cells[2] + 1) + (size_t)k);
                x[0] = size[0] * (i / nx);
                x[1] = size[1] * (j / ny);
                x[2] = size[2] * (k / nz);
            }
    for (i = 0; i < cells[0]; ++i)
        for (j = 0; j < cells[1]; ++j)
            for (k = 0; k < cells[2]; ++k) {
                sfem_int n, node[8];
                for (n = 0; n < 8; ++n)
                    node[n] =
                        ((i + (n >> 2)) * (cells[1] + 1) + j + (n >> 1 & 1)) * (cells[2] + 1) + k +
                        (n & 1);
                sfemi_mesh_cell(&m, &count, node, (int)((i ^ j ^ k) & 1), kind);
            }
    *out = m;
    return SFEM_OK;
}

/* Number k of the 6r nodes of ring r of a cross-section; ring 0 is its centre. */
static sfem_int sfemi_mesh_ring_node(sfem_int r, sfem_int k)
{
    return r == 0 ? 0 : 1 + 3 * r * (r - 1) + k % (6 * r);
}

/* The prism over triangle a b c of a cross-section, in three tets: every side is cut from the lower
 * numbered edge's foot to the higher one's head [Dompierre et al. 1999], so neighbours agree. Every
 * other layer is turned over, against a common twist. */
static void sfemi_mesh_prism(sfem_mesh *m, sfem_int *count, sfem_int a, sfem_int b, sfem_int c,
                             sfem_int layer, sfem_int section)
{
    sfem_int s, foot = (layer + (layer & 1)) * section, head = (layer + 1 - (layer & 1)) * section;
    if (a > b) s = a, a = b, b = s;
    if (b > c) s = b, b = c, c = s;
    if (a > b) s = a, a = b, b = s;
    sfemi_mesh_put(m, count, foot + a, foot + b, foot + c, head + c);
    sfemi_mesh_put(m, count, foot + a, foot + b, head + b, head + c);
    sfemi_mesh_put(m, count, foot + a, head + a, head + b, head + c);
}

SFEM_DEF sfem_status sfem_mesh_cylinder(sfem_real radius, sfem_real length, sfem_int rings,
                                        sfem_int layers, const sfem_allocator *allocator,
                                        sfem_mesh *out, sfem_error *err)
{
    const double pi = 3.14159265358979323846, nr = rings, nl = layers;
    sfem_status status;
    sfem_mesh m;
    sfem_int i, r, k, s, section, count = 0, counts[2];
    sfem_real sizes[2];
    SFEM_ASSERT(out);
    counts[0] = rings, counts[1] = layers;
    sizes[0] = radius, sizes[1] = length;
    status = sfemi_mesh_counts_and_sizes("cylinder", counts, 2, sizes, 2, err);
    if (status != SFEM_OK) return status;
    status =
        sfemi_mesh_new((3 * nr * (nr + 1) + 1) * (nl + 1), 18 * nr * nr * nl, allocator, &m, err);
    if (status != SFEM_OK) return status;
    section = 3 * rings * (rings + 1) + 1;
    for (i = 0; i <= layers; ++i)
        for (r = 0; r <= rings; ++r)
            for (k = 0; k < (r ? 6 * r : 1); ++k) {
                sfem_real *x =
                    m.x + 3 * ((size_t)i * (size_t)section + (size_t)sfemi_mesh_ring_node(r, k));
                sfem_real angle = r ? 2 * pi * k / (6.0 * r) : 0;
                x[0] = length * (i / nl);
                x[1] = radius * (r / nr) * cos(angle);
                x[2] = radius * (r / nr) * sin(angle);
            }
    for (i = 0; i < layers; ++i)
        for (r = 1; r <= rings; ++r)
            for (s = 0; s < 6; ++s) /* six sectors, of r outer and r - 1 inner triangles */
                for (k = 0; k < r; ++k) {
                    sfem_int out0 = sfemi_mesh_ring_node(r, s * r + k);
                    sfem_int out1 = sfemi_mesh_ring_node(r, s * r + k + 1);
                    sfem_int in0 = sfemi_mesh_ring_node(r - 1, s * (r - 1) + k);
                    sfem_int in1 = sfemi_mesh_ring_node(r - 1, s * (r - 1) + k + 1);
                    sfemi_mesh_prism(&m, &count, in0, out0, out1, i, section);
                    if (k < r - 1) sfemi_mesh_prism(&m, &count, in0, in1, out1, i, section);
                }
    *out = m;
    return SFEM_OK;
}

/* The icosahedron: its corners, and the numbers of its edges and faces (corners ascending). */
typedef struct sfemi_mesh_icosahedron {
    sfem_real corner[12][3];
    sfem_int edge[12][12]; /* number of the edge a < b, or -1 */
    sfem_int face[20][3];
} sfemi_mesh_icosahedron;

static void sfemi_mesh_icosahedron_set(sfemi_mesh_icosahedron *s)
{
    const sfem_real golden = 0.5 * (1 + sqrt(5.0));
    sfem_int a, b, c, edges = 0, faces = 0;
    for (a = 0; a < 12; ++a) { /* the cyclic shifts of (0, +-1, +-golden): edges of length 2 */
        s->corner[a][a / 4] = 0;
        s->corner[a][(a / 4 + 1) % 3] = a & 1 ? -1 : 1;
        s->corner[a][(a / 4 + 2) % 3] = a & 2 ? -golden : golden;
    }
    for (a = 0; a < 12; ++a)
        for (b = 0; b < 12; ++b) {
            sfem_real d[3];
            sfemi_sub3(s->corner[a], s->corner[b], d);
            s->edge[a][b] = a < b && sfemi_dot3(d, d) < 5 ? edges++ : -1;
        }
    for (a = 0; a < 12; ++a)
        for (b = a + 1; b < 12; ++b)
            for (c = b + 1; c < 12; ++c)
                if (s->edge[a][b] >= 0 && s->edge[b][c] >= 0 && s->edge[a][c] >= 0) {
                    s->face[faces][0] = a;
                    s->face[faces][1] = b;
                    s->face[faces++][2] = c;
                }
}

/* The node of shell r on face f with integer weights w, sum r, of the face's corners. Within a
 * shell come the corners, then the edges, then the faces. */
static sfem_int sfemi_mesh_shell_node(const sfemi_mesh_icosahedron *s, sfem_int f,
                                      const sfem_int w[3])
{
    const sfem_int *v = s->face[f], r = w[0] + w[1] + w[2];
    sfem_int i, a, b, base;
    if (r == 0) return 0;
    base = 1 + 5 * (r - 1) * r * (2 * r - 1) / 3 + 2 * (r - 1);
    for (i = 0; i < 3; ++i)
        if (w[i] == r) return base + v[i];
    base += 12;
    for (i = 0; i < 3; ++i)
        if (w[i] == 0) {
            a = i == 0 ? 1 : 0;
            b = i == 2 ? 1 : 2;
            return base + s->edge[v[a]][v[b]] * (r - 1) + w[b] - 1;
        }
    base += 30 * (r - 1) + f * ((r - 1) * (r - 2) / 2);
    return base + (w[1] - 1) * (r - 1) - (w[1] - 1) * w[1] / 2 + w[2] - 1;
}

/* The cone from the centre to face f is the simplex rings >= X >= Y >= Z >= 0 of an integer grid, X
 * being the shell; the grid's cubes are cut in six round their diagonals, and what lies in the
 * simplex is kept. On the simplex's faces that is the plain triangular pattern, so cones match. */
static void sfemi_mesh_cone(sfem_mesh *m, sfem_int *count, const sfemi_mesh_icosahedron *s,
                            sfem_int f, sfem_int rings)
{
    sfem_int X, Y, Z, p, i;
    for (X = 0; X < rings; ++X)
        for (Y = 0; Y <= X; ++Y)
            for (Z = 0; Z <= Y; ++Z)
                for (p = 0; p < 6; ++p) {
                    sfem_int node[4], w[3], x = X, y = Y, z = Z;
                    for (i = 0; i < 4; ++i) {
                        if (i > 0) {
                            int bit = sfemi_mesh_walk[p][i - 1];
                            x += bit & 1, y += bit >> 1 & 1, z += bit >> 2;
                        }
                        if (y > x || z > y) break;
                        w[0] = x - y, w[1] = y - z, w[2] = z;
                        node[i] = sfemi_mesh_shell_node(s, f, w);
                    }
                    if (i == 4) sfemi_mesh_put(m, count, node[0], node[1], node[2], node[3]);
                }
}

SFEM_DEF sfem_status sfem_mesh_ball(sfem_real radius, sfem_int rings,
                                    const sfem_allocator *allocator, sfem_mesh *out,
                                    sfem_error *err)
{
    const double n = rings;
    sfem_status status = sfemi_mesh_counts_and_sizes("ball", &rings, 1, &radius, 1, err);
    sfemi_mesh_icosahedron s;
    sfem_mesh m;
    sfem_int f, r, i, count = 0, w[3];
    SFEM_ASSERT(out);
    if (status != SFEM_OK) return status;
    status = sfemi_mesh_new(1 + 5 * n * (n + 1) * (2 * n + 1) / 3 + 2 * n, 20 * n * n * n,
                            allocator, &m, err);
    if (status != SFEM_OK) return status;
    sfemi_mesh_icosahedron_set(&s);
    for (f = 0; f < 20; ++f) {
        const sfem_int *v = s.face[f];
        for (r = 1; r <= rings; ++r)
            for (w[1] = 0; w[1] <= r; ++w[1])
                for (w[2] = 0; w[2] <= r - w[1]; ++w[2]) {
                    sfem_real *x, p[3], length;
                    w[0] = r - w[1] - w[2];
                    x = m.x + 3 * (size_t)sfemi_mesh_shell_node(&s, f, w);
                    for (i = 0; i < 3; ++i)
                        p[i] = w[0] * s.corner[v[0]][i] + w[1] * s.corner[v[1]][i] +
                               w[2] * s.corner[v[2]][i];
                    length = sqrt(sfemi_dot3(p, p));
                    for (i = 0; i < 3; ++i) x[i] = radius * (r / n) * (p[i] / length);
                }
    }
    for (f = 0; f < 20; ++f) sfemi_mesh_cone(&m, &count, &s, f, rings);
    *out = m;
    return SFEM_OK;
}

/* ---- checks ---- */

#define SFEMI_MESH_FLAT 1e-12 /* |quality| below this is no volume */

typedef enum sfemi_mesh_fault {
    SFEMI_TET_GOOD,
    SFEMI_TET_INVERTED,
    SFEMI_TET_FLAT, /* the worse ones from here on have no shape */
    SFEMI_TET_REPEATED,
    SFEMI_TET_OUT_OF_RANGE,
    SFEMI_TET_NOT_FINITE
} sfemi_mesh_fault;

/* The six edges of a tet, first those from node 0. */
static const unsigned char sfemi_mesh_edge[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

/* Quality of a tet, and its edge lengths. Edges are scaled first: no under- or overflow. */
static sfem_real sfemi_mesh_quality(const sfem_real *x, const sfem_int *tet, sfem_real length[6])
{
    sfem_real e[6][3], n[3], scale = 0, sum = 0;
    int i, k;
    for (i = 0; i < 6; ++i) {
        sfemi_sub3(x + 3 * (size_t)tet[sfemi_mesh_edge[i][1]],
                   x + 3 * (size_t)tet[sfemi_mesh_edge[i][0]], e[i]);
        for (k = 0; k < 3; ++k)
            if (fabs(e[i][k]) > scale) scale = fabs(e[i][k]);
    }
    memset(length, 0, 6 * sizeof *length);
    if (!sfemi_finite(scale) || scale < 1e-300) return 0;
    for (i = 0; i < 6; ++i) {
        for (k = 0; k < 3; ++k) e[i][k] *= 1 / scale;
        length[i] = sfemi_dot3(e[i], e[i]);
        sum += length[i];
        length[i] = scale * sqrt(length[i]);
    }
    sfemi_cross(e[0], e[1], n);
    sum /= 6;
    return sqrt(2.0) * sfemi_dot3(n, e[2]) / (sum * sqrt(sum));
}

static sfemi_mesh_fault sfemi_mesh_judge(const sfem_mesh *m, sfem_int t, sfem_real *quality,
                                         sfem_real length[6])
{
    const sfem_int *v = m->tet + 4 * (size_t)t;
    int i;
    for (i = 0; i < 4; ++i)
        if (v[i] < 0 || v[i] >= m->nodes) return SFEMI_TET_OUT_OF_RANGE;
    for (i = 0; i < 6; ++i)
        if (v[sfemi_mesh_edge[i][0]] == v[sfemi_mesh_edge[i][1]]) return SFEMI_TET_REPEATED;
    for (i = 0; i < 4; ++i)
        if (!sfemi_all_finite(m->x + 3 * (size_t)v[i], 3)) return SFEMI_TET_NOT_FINITE;
    *quality = sfemi_mesh_quality(m->x, v, length);
    if (fabs(*quality) < SFEMI_MESH_FLAT) return SFEMI_TET_FLAT;
    return *quality < 0 ? SFEMI_TET_INVERTED : SFEMI_TET_GOOD;
}

/* The sentence about tet t. */
static sfem_status sfemi_mesh_complain(const sfem_mesh *m, sfem_int t, sfemi_mesh_fault fault,
                                       sfem_real quality, sfem_error *err)
{
    const sfem_int *v = m->tet + 4 * (size_t)t;
    int i = 0;
    switch (fault) {
    case SFEMI_TET_OUT_OF_RANGE:
        while (v[i] >= 0 && v[i] < m->nodes) ++i;
        return sfemi_fail_at(err, SFEM_BAD_MESH, v[i], t,
                             "tet %ld names node %ld, the mesh has %ld", (long)t, (long)v[i],
                             (long)m->nodes);
    case SFEMI_TET_REPEATED:
        while (v[sfemi_mesh_edge[i][0]] != v[sfemi_mesh_edge[i][1]]) ++i;
        return sfemi_fail_at(err, SFEM_BAD_MESH, v[sfemi_mesh_edge[i][0]], t,
                             "tet %ld names node %ld twice", (long)t,
                             (long)v[sfemi_mesh_edge[i][0]]);
    case SFEMI_TET_FLAT:
        return sfemi_fail_at(err, SFEM_BAD_MESH, -1, t,
                             "tet %ld (nodes %ld %ld %ld %ld) is flat: its quality is %.2g",
                             (long)t, (long)v[0], (long)v[1], (long)v[2], (long)v[3], quality);
    default:
        return sfemi_fail_at(err, SFEM_BAD_MESH, -1, t,
                             "tet %ld (nodes %ld %ld %ld %ld) is inverted, its quality is %.2g: "
                             "sfem_mesh_orient turns such tets",
                             (long)t, (long)v[0], (long)v[1], (long)v[2], (long)v[3], quality);
    }
}

/* No node number out of range: all that the functions on connectivity need. */
static sfem_status sfemi_mesh_in_range(const sfem_mesh *m, sfem_error *err)
{
    size_t i, n = 4 * (size_t)m->tets;
    SFEM_ASSERT(m->x && m->tet && m->nodes >= 0 && m->tets >= 0);
    for (i = 0; i < n; ++i)
        if (m->tet[i] < 0 || m->tet[i] >= m->nodes)
            return sfemi_mesh_complain(m, (sfem_int)(i / 4), SFEMI_TET_OUT_OF_RANGE, 0, err);
    return SFEM_OK;
}

SFEM_DEF sfem_int sfem_mesh_orient(sfem_mesh *mesh)
{
    sfem_int t, turned = 0;
    SFEM_ASSERT(mesh);
    for (t = 0; t < mesh->tets; ++t) {
        sfem_int *v = mesh->tet + 4 * (size_t)t, d = v[3];
        sfem_real quality, length[6];
        if (sfemi_mesh_judge(mesh, t, &quality, length) != SFEMI_TET_INVERTED) continue;
        v[3] = v[2];
        v[2] = d;
        ++turned;
    }
    return turned;
}

/* ---- surface ---- */

/* Stable counting sort of in[0..count) (NULL: of 0..count-1) by key[in[i] stride], in [0,
 * range). */
static void sfemi_mesh_sort(const sfem_int *key, size_t stride, sfem_int count, sfem_int range,
                            const sfem_int *in, sfem_int *out, sfem_int *bucket /* [range+1] */)
{
    sfem_int i, item;
    memset(bucket, 0, ((size_t)range + 1) * sizeof *bucket);
    for (i = 0; i < count; ++i) ++bucket[key[(size_t)i * stride] + 1];
    for (i = 0; i < range; ++i) bucket[i + 1] += bucket[i];
    for (i = 0; i < count; ++i) {
        item = in ? in[i] : i;
        out[bucket[key[(size_t)item * stride]]++] = item;
    }
}

/* The faces of a right-handed tet, counterclockwise from outside; face f is opposite node f. */
static const unsigned char sfemi_mesh_face[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

/* key = the three nodes of a face in ascending order; returns 1 or 0 for its sense. */
static unsigned char sfemi_mesh_face_key(const sfem_int *tet, sfem_int face, sfem_int key[3])
{
    sfem_int s;
    unsigned char sense = 1;
    int i;
    for (i = 0; i < 3; ++i) key[i] = tet[sfemi_mesh_face[face][i]];
    if (key[0] > key[1]) s = key[0], key[0] = key[1], key[1] = s, sense ^= 1;
    if (key[1] > key[2]) s = key[1], key[1] = key[2], key[2] = s, sense ^= 1;
    if (key[0] > key[1]) s = key[0], key[0] = key[1], key[1] = s, sense ^= 1;
    return sense;
}

/* on_surface[4t+f] = 1 for the faces that stay when faces of opposite sense have cancelled. Equal
 * faces meet by sorting on each of their nodes in turn. */
static sfem_status sfemi_mesh_boundary(const sfem_mesh *m, const sfem_allocator *allocator,
                                       unsigned char *on_surface, sfem_int *overlapping,
                                       sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfem_int *key = NULL, *order = NULL, *other = NULL, *bucket = NULL, faces = 4 * m->tets, i, j,
             k;
    SFEMI_NEW(sfem_int, key, allocator, 3 * (size_t)faces);
    SFEMI_NEW(sfem_int, order, allocator, faces);
    SFEMI_NEW(sfem_int, other, allocator, faces);
    SFEMI_NEW(sfem_int, bucket, allocator, (size_t)m->nodes + 1);
    for (i = 0; i < faces; ++i)
        on_surface[i] = sfemi_mesh_face_key(m->tet + (size_t)(i & ~3), i & 3, key + 3 * (size_t)i);
    sfemi_mesh_sort(key + 2, 3, faces, m->nodes, NULL, order, bucket);
    sfemi_mesh_sort(key + 1, 3, faces, m->nodes, order, other, bucket);
    sfemi_mesh_sort(key, 3, faces, m->nodes, other, order, bucket);
    *overlapping = 0;
    for (i = 0; i < faces; i = j) {
        sfem_int ones = 0, zeros, excess;
        unsigned char sense;
        for (j = i; j < faces; ++j) {
            if (memcmp(key + 3 * (size_t)order[j], key + 3 * (size_t)order[i], 3 * sizeof *key))
                break;
            ones += on_surface[order[j]];
        }
        zeros = j - i - ones;
        *overlapping += ones > 1 || zeros > 1;
        sense = ones > zeros;
        excess = sense ? ones - zeros : zeros - ones;
        for (k = i; k < j; ++k) /* keep the first ones of the sense that is in excess */
            on_surface[order[k]] = on_surface[order[k]] == sense && excess-- > 0;
    }
done:
    sfemi_delete(allocator, key);
    sfemi_delete(allocator, order);
    sfemi_delete(allocator, other);
    sfemi_delete(allocator, bucket);
    return status;
}

SFEM_DEF void sfem_surface_free(sfem_surface *surface)
{
    if (!surface) return;
    sfemi_delete(&surface->allocator, surface->tri);
    sfemi_delete(&surface->allocator, surface->tet);
    memset(surface, 0, sizeof *surface);
}

static sfem_status sfemi_mesh_surface(const sfem_mesh *mesh, const sfem_allocator *allocator,
                                      sfem_surface *out, sfem_int *overlapping, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    unsigned char *on_surface = NULL;
    sfem_int i, k, n;
    sfem_allocator a;
    sfem_surface s;
    memset(&s, 0, sizeof s);
    if (allocator) s.allocator = *allocator;
    a = s.allocator;
    SFEMI_TRY(sfemi_mesh_in_range(mesh, err));
    if (mesh->tets > INT32_MAX / 4) {
        status = sfemi_fail(err, SFEM_TOO_LARGE, "%ld tets have more faces than can be numbered",
                            (long)mesh->tets);
        goto done;
    }
    SFEMI_NEW(unsigned char, on_surface, &a, 4 * mesh->tets);
    SFEMI_TRY(sfemi_mesh_boundary(mesh, &a, on_surface, overlapping, err));
    for (i = 0, n = 0; i < 4 * mesh->tets; ++i) n += on_surface[i];
    SFEMI_NEW(sfem_int, s.tri, &a, 3 * (size_t)n);
    SFEMI_NEW(sfem_int, s.tet, &a, n);
    s.triangles = n;
    for (i = 0, n = 0; i < 4 * mesh->tets; ++i) {
        if (!on_surface[i]) continue;
        for (k = 0; k < 3; ++k)
            s.tri[3 * (size_t)n + (size_t)k] =
                mesh->tet[(size_t)(i & ~3) + sfemi_mesh_face[i & 3][k]];
        s.tet[n++] = i / 4;
    }
    *out = s;
done:
    if (status != SFEM_OK) sfem_surface_free(&s);
    sfemi_delete(&a, on_surface);
    return status;
}

SFEM_DEF sfem_status sfem_mesh_surface(const sfem_mesh *mesh, const sfem_allocator *allocator,
                                       sfem_surface *out, sfem_error *err)
{
    sfem_int overlapping;
    SFEM_ASSERT(mesh && out);
    return sfemi_mesh_surface(mesh, allocator, out, &overlapping, err);
}

/* ---- components ---- */

SFEM_DEF sfem_status sfem_mesh_components(const sfem_mesh *mesh, sfem_int *label, sfem_int *count,
                                          sfem_error *err)
{
    sfem_status status;
    sfem_int t, i, n = 0;
    int k;
    SFEM_ASSERT(mesh && label);
    status = sfemi_mesh_in_range(mesh, err);
    if (status != SFEM_OK) return status;
    for (i = 0; i < mesh->nodes; ++i) label[i] = -1;
    for (t = 0; t < mesh->tets;
         ++t) { /* label = a lower node of the same part, or the node itself */
        const sfem_int *v = mesh->tet + 4 * (size_t)t;
        sfem_int root[4], low = mesh->nodes;
        for (k = 0; k < 4; ++k) {
            i = v[k];
            if (label[i] < 0) label[i] = i;
            while (label[i] != i) {
                label[i] = label[label[i]];
                i = label[i];
            }
            root[k] = i;
            if (i < low) low = i;
        }
        for (k = 0; k < 4; ++k) label[root[k]] = low;
    }
    for (i = 0; i < mesh->nodes; ++i) /* lower nodes already have their part's number */
        if (label[i] >= 0) label[i] = label[i] == i ? n++ : label[label[i]];
    if (count) *count = n;
    return SFEM_OK;
}

/* ---- report ---- */

/* Nodes at the exact place of an earlier one: open addressing, by the bits of the coordinates. */
static sfem_status sfemi_mesh_coincident(const sfem_mesh *m, sfem_int *coincident, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfem_int *table = NULL, i, n = 0;
    size_t size = 16, slot;
    while (size < 2 * (size_t)m->nodes) size *= 2;
    SFEMI_NEW(sfem_int, table, &m->allocator, size);
    for (i = 0; i < m->nodes; ++i) {
        uint64_t hash = 0, bits;
        int k;
        if (!sfemi_all_finite(m->x + 3 * (size_t)i, 3)) continue;
        for (k = 0; k < 3; ++k) {
            sfem_real x = m->x[3 * (size_t)i + (size_t)k];
            memcpy(&bits, &x, sizeof bits);
            if (x == 0) bits = 0; /* -0 is at the place of 0 */
            hash = (hash ^ bits) * 0x9e3779b97f4a7c15u;
            hash ^= hash >> 32;
        }
        for (slot = (size_t)hash & (size - 1); table[slot]; slot = (slot + 1) & (size - 1)) {
            const sfem_real *a = m->x + 3 * (size_t)i, *b = m->x + 3 * (size_t)(table[slot] - 1);
            if (a[0] == b[0] && a[1] == b[1] && a[2] == b[2]) break;
        }
        if (table[slot])
            ++n;
        else
            table[slot] = i + 1;
    }
    *coincident = n;
done:
    sfemi_delete(&m->allocator, table);
    return status;
}

/* Counts what the report says about the surface. */
static sfem_status sfemi_mesh_report_surface(const sfem_mesh *m, sfem_mesh_report *r,
                                             sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfem_int *key = NULL, *order = NULL, *other = NULL, *bucket = NULL, i, k, edges;
    sfem_surface s;
    memset(&s, 0, sizeof s);
    SFEMI_TRY(sfemi_mesh_surface(m, &m->allocator, &s, &r->overlapping, err));
    if (s.triangles > INT32_MAX / 3) {
        status = sfemi_fail(err, SFEM_TOO_LARGE, "%ld surface triangles", (long)s.triangles);
        goto done;
    }
    edges = 3 * s.triangles;
    SFEMI_NEW(sfem_int, key, &m->allocator, 2 * (size_t)edges);
    SFEMI_NEW(sfem_int, order, &m->allocator, edges);
    SFEMI_NEW(sfem_int, other, &m->allocator, edges);
    SFEMI_NEW(sfem_int, bucket, &m->allocator, (size_t)m->nodes + 1);
    for (i = 0; i < edges; ++i) {
        sfem_int a = s.tri[i], b = s.tri[i % 3 == 2 ? i - 2 : i + 1];
        key[2 * (size_t)i] = a < b ? a : b;
        key[2 * (size_t)i + 1] = a < b ? b : a;
    }
    sfemi_mesh_sort(key + 1, 2, edges, m->nodes, NULL, other, bucket);
    sfemi_mesh_sort(key, 2, edges, m->nodes, other, order, bucket);
    r->surface_triangles = s.triangles;
    r->surface_edges = r->surface_nodes = 0;
    for (i = 0; i < edges; ++i) {
        const sfem_int *e = key + 2 * (size_t)order[i],
                       *last = i ? key + 2 * (size_t)order[i - 1] : NULL;
        r->surface_edges += !last || last[0] != e[0] || last[1] != e[1];
    }
    memset(bucket, 0, ((size_t)m->nodes + 1) * sizeof *bucket);
    for (i = 0; i < edges; ++i) {
        k = s.tri[i];
        r->surface_nodes += bucket[k] == 0;
        bucket[k] = 1;
    }
    r->euler = r->surface_nodes - r->surface_edges + r->surface_triangles;
done:
    sfemi_delete(&m->allocator, key);
    sfemi_delete(&m->allocator, order);
    sfemi_delete(&m->allocator, other);
    sfemi_delete(&m->allocator, bucket);
    sfem_surface_free(&s);
    return status;
}

static sfem_status sfemi_mesh_report_topology(const sfem_mesh *m, sfem_mesh_report *r,
                                              sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfem_int *label = NULL, i;
    SFEMI_TRY(sfemi_mesh_coincident(m, &r->coincident, err));
    if (r->out_of_range || r->repeated || m->tets < 1) goto done;
    SFEMI_NEW(sfem_int, label, &m->allocator, m->nodes);
    SFEMI_TRY(sfem_mesh_components(m, label, &r->components, err));
    for (i = 0, r->unused = 0; i < m->nodes; ++i) r->unused += label[i] < 0;
    SFEMI_TRY(sfemi_mesh_report_surface(m, r, err));
done:
    sfemi_delete(&m->allocator, label);
    return status;
}

static void sfemi_mesh_report_tet(const sfem_mesh *m, sfem_int t, sfem_real quality,
                                  const sfem_real length[6], sfem_mesh_report *r)
{
    const sfem_int *v = m->tet + 4 * (size_t)t;
    sfem_real volume = sfemi_volume6(m->x + 3 * (size_t)v[0], m->x + 3 * (size_t)v[1],
                                     m->x + 3 * (size_t)v[2], m->x + 3 * (size_t)v[3]) /
                       6;
    int i, first = r->worst_tet < 0;
    if (first || quality < r->min_quality) {
        r->min_quality = quality;
        r->worst_tet = t;
    }
    r->volume += volume;
    if (first || volume < r->min_volume) r->min_volume = volume;
    if (first || volume > r->max_volume) r->max_volume = volume;
    for (i = 0; i < 6; ++i) {
        if ((first && i == 0) || length[i] < r->min_edge) r->min_edge = length[i];
        if (length[i] > r->max_edge) r->max_edge = length[i];
    }
}

static void sfemi_mesh_report_box(const sfem_mesh *m, sfem_mesh_report *r)
{
    sfem_int i;
    int k, first = 1;
    for (i = 0; i < m->nodes; ++i) {
        const sfem_real *x = m->x + 3 * (size_t)i;
        if (!sfemi_all_finite(x, 3)) {
            ++r->not_finite;
            continue;
        }
        for (k = 0; k < 3; ++k) {
            if (first || x[k] < r->box[0][k]) r->box[0][k] = x[k];
            if (first || x[k] > r->box[1][k]) r->box[1][k] = x[k];
        }
        first = 0;
    }
}

/* Goes over all tets, fills r and returns the first fault: its tet and quality. */
static sfemi_mesh_fault sfemi_mesh_report_tets(const sfem_mesh *m, sfem_mesh_report *r,
                                               sfem_int *tet, sfem_real *quality)
{
    sfemi_mesh_fault fault, first = SFEMI_TET_GOOD;
    sfem_real q, sum = 0, length[6];
    sfem_int t, shaped = 0;
    for (t = 0; t < m->tets; ++t) {
        q = 0;
        fault = sfemi_mesh_judge(m, t, &q, length);
        r->out_of_range += fault == SFEMI_TET_OUT_OF_RANGE;
        r->repeated += fault == SFEMI_TET_REPEATED;
        r->flat += fault == SFEMI_TET_FLAT;
        r->inverted += fault == SFEMI_TET_INVERTED;
        if (fault <= SFEMI_TET_FLAT) {
            sfemi_mesh_report_tet(m, t, q, length, r);
            sum += q;
            ++shaped;
        }
        if (fault == SFEMI_TET_GOOD || first != SFEMI_TET_GOOD) continue;
        first = fault;
        *tet = t;
        *quality = q;
    }
    r->mean_quality = shaped ? sum / shaped : 0;
    return first;
}

SFEM_DEF sfem_status sfem_mesh_check(const sfem_mesh *mesh, sfem_mesh_report *report,
                                     sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfemi_mesh_fault fault;
    sfem_mesh_report r;
    sfem_int t = -1, i;
    sfem_real quality = 0;
    SFEM_ASSERT(mesh && mesh->nodes >= 0 && mesh->tets >= 0);
    SFEM_ASSERT((mesh->x || !mesh->nodes) && (mesh->tet || !mesh->tets));
    memset(&r, 0, sizeof r);
    r.worst_tet = r.unused = r.overlapping = r.components = -1;
    r.surface_triangles = r.surface_edges = r.surface_nodes = r.euler = -1;
    sfemi_mesh_report_box(mesh, &r);
    fault = sfemi_mesh_report_tets(mesh, &r, &t, &quality);
    if (report) {
        status = sfemi_mesh_report_topology(mesh, &r, err);
        if (status != SFEM_OK) return status;
        *report = r;
    }
    if (mesh->nodes < 1 || mesh->tets < 1)
        return sfemi_fail(err, SFEM_BAD_MESH, "the mesh is empty: %ld nodes, %ld tets",
                          (long)mesh->nodes, (long)mesh->tets);
    if (r.not_finite) {
        for (i = 0; sfemi_all_finite(mesh->x + 3 * (size_t)i, 3);) ++i;
        return sfemi_fail_at(err, SFEM_NOT_FINITE, i, -1, "node %ld is at (%g, %g, %g)", (long)i,
                             mesh->x[3 * (size_t)i], mesh->x[3 * (size_t)i + 1],
                             mesh->x[3 * (size_t)i + 2]);
    }
    return fault == SFEMI_TET_GOOD ? SFEM_OK : sfemi_mesh_complain(mesh, t, fault, quality, err);
}

SFEM_DEF sfem_status sfem_mesh_copy(sfem_int nodes, const sfem_real *x, sfem_int tets,
                                    const sfem_int *tet, const sfem_allocator *allocator,
                                    sfem_mesh *out, sfem_error *err)
{
    sfem_status status;
    sfem_mesh m;
    SFEM_ASSERT(out && nodes >= 0 && tets >= 0 && (x || !nodes) && (tet || !tets));
    status = sfemi_mesh_new(nodes, tets, allocator, &m, err);
    if (status != SFEM_OK) return status;
    if (nodes) memcpy(m.x, x, 3 * (size_t)nodes * sizeof *x);
    if (tets) memcpy(m.tet, tet, 4 * (size_t)tets * sizeof *tet);
    sfem_mesh_orient(&m);
    status = sfem_mesh_check(&m, NULL, err);
    if (status == SFEM_OK)
        *out = m;
    else
        sfem_mesh_free(&m);
    return status;
}

/* ---- numbering ---- */

/* Each node's neighbours, those of few neighbours first. */
typedef struct sfemi_mesh_graph {
    size_t *start;      /* [nodes+1] */
    sfem_int *adjacent; /* [start[nodes]] */
} sfemi_mesh_graph;

/* list[first[v] .. first[v+1]): the tets of node v, ascending. first [nodes+1] comes zeroed. */
static void sfemi_mesh_incidence(const sfem_mesh *m, sfem_int *first, sfem_int *list)
{
    size_t i, n = 4 * (size_t)m->tets;
    sfem_int v;
    for (i = 0; i < n; ++i) ++first[m->tet[i]];
    for (v = 0; v < m->nodes; ++v) first[v + 1] += first[v];
    for (i = n; i-- > 0;) list[--first[m->tet[i]]] = (sfem_int)(i / 4);
}

/* near = the neighbours of v; mark [nodes] holds no v. Returns how many. */
static sfem_int sfemi_mesh_neighbours(const sfem_mesh *m, const sfem_int *first,
                                      const sfem_int *list, sfem_int v, sfem_int *mark,
                                      sfem_int *near)
{
    sfem_int i, k, u, n = 0;
    mark[v] = v;
    for (i = first[v]; i < first[v + 1]; ++i)
        for (k = 0; k < 4; ++k) {
            u = m->tet[4 * (size_t)list[i] + (size_t)k];
            if (mark[u] == v) continue;
            mark[u] = v;
            near[n++] = u;
        }
    return n;
}

/* Nodes are visited by ascending degree, and each one enters its neighbours' lists: so these come
 * out sorted without being sorted. */
static sfem_status sfemi_mesh_graph_new(const sfem_mesh *m, sfemi_mesh_graph *g, sfem_error *err)
{
    const sfem_allocator *a = &m->allocator;
    sfem_status status = SFEM_OK;
    sfem_int *first = NULL, *list = NULL, *mark = NULL, *near = NULL, *degree = NULL, *order = NULL;
    sfem_int i, k, v, n = m->nodes;
    size_t *fill = NULL;
    SFEMI_NEW(sfem_int, first, a, (size_t)n + 1);
    SFEMI_NEW(sfem_int, list, a, 4 * (size_t)m->tets);
    SFEMI_NEW(sfem_int, mark, a, n);
    SFEMI_NEW(sfem_int, near, a, (size_t)n + 1); /* also the sort's buckets */
    SFEMI_NEW(sfem_int, degree, a, n);
    SFEMI_NEW(sfem_int, order, a, n);
    SFEMI_NEW(size_t, fill, a, n);
    SFEMI_NEW(size_t, g->start, a, (size_t)n + 1);
    sfemi_mesh_incidence(m, first, list);
    for (v = 0; v < n; ++v) mark[v] = -1;
    for (v = 0; v < n; ++v) {
        degree[v] = sfemi_mesh_neighbours(m, first, list, v, mark, near);
        fill[v] = g->start[v];
        g->start[v + 1] = g->start[v] + (size_t)degree[v];
    }
    SFEMI_NEW(sfem_int, g->adjacent, a, g->start[n]);
    sfemi_mesh_sort(degree, 1, n, n, NULL, order, near);
    for (v = 0; v < n; ++v) mark[v] = -1;
    for (i = 0; i < n; ++i) {
        sfem_int count = sfemi_mesh_neighbours(m, first, list, order[i], mark, near);
        for (k = 0; k < count; ++k) g->adjacent[fill[near[k]]++] = order[i];
    }
done:
    sfemi_delete(a, first);
    sfemi_delete(a, list);
    sfemi_delete(a, mark);
    sfemi_delete(a, near);
    sfemi_delete(a, degree);
    sfemi_delete(a, order);
    sfemi_delete(a, fill);
    return status;
}

/* Breadth first from root, through nodes not yet seen: the Cuthill-McKee order of its part of the
 * mesh. Returns how many nodes; *depth counts the levels, *last is where in queue the last one
 * begins. */
static sfem_int sfemi_mesh_breadth_first(const sfemi_mesh_graph *g, sfem_int root,
                                         unsigned char *seen, sfem_int *queue, sfem_int *depth,
                                         sfem_int *last)
{
    sfem_int head = 0, tail = 1, level_end;
    size_t k;
    queue[0] = root;
    seen[root] = 1;
    *depth = 0;
    while (head < tail) {
        *last = head;
        ++*depth;
        for (level_end = tail; head < level_end; ++head)
            for (k = g->start[queue[head]]; k < g->start[queue[head] + 1]; ++k) {
                sfem_int u = g->adjacent[k];
                if (seen[u]) continue;
                seen[u] = 1;
                queue[tail++] = u;
            }
    }
    return tail;
}

/* queue = the part of node `root` in reverse Cuthill-McKee order, begun at an end of the part: jump
 * to a node of least degree in the last level until that takes one no further [George, Liu]. */
static sfem_int sfemi_mesh_order_part(const sfemi_mesh_graph *g, sfem_int root, unsigned char *seen,
                                      sfem_int *queue)
{
    sfem_int n, i, depth, before = 0, last = 0, tries;
    for (tries = 0;; ++tries) {
        n = sfemi_mesh_breadth_first(g, root, seen, queue, &depth, &last);
        if (depth <= before || tries == 10) break; /* 10 keeps the worst case linear */
        before = depth;
        root = queue[last];
        for (i = last + 1; i < n; ++i)
            if (g->start[queue[i] + 1] - g->start[queue[i]] < g->start[root + 1] - g->start[root])
                root = queue[i];
        for (i = 0; i < n; ++i) seen[queue[i]] = 0;
    }
    for (i = 0; i < n / 2; ++i) {
        sfem_int s = queue[i];
        queue[i] = queue[n - 1 - i];
        queue[n - 1 - i] = s;
    }
    return n;
}

/* old_of_new, part by part, unused nodes last. */
static sfem_status sfemi_mesh_order(const sfem_mesh *m, sfem_int *old_of_new, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    unsigned char *seen = NULL;
    sfemi_mesh_graph g = {NULL, NULL};
    sfem_int v, n = 0;
    SFEMI_NEW(unsigned char, seen, &m->allocator, m->nodes);
    SFEMI_TRY(sfemi_mesh_graph_new(m, &g, err));
    for (v = 0; v < m->nodes; ++v)
        if (!seen[v] && g.start[v + 1] > g.start[v])
            n += sfemi_mesh_order_part(&g, v, seen, old_of_new + n);
    for (v = 0; v < m->nodes; ++v)
        if (!seen[v]) old_of_new[n++] = v;
done:
    sfemi_delete(&m->allocator, seen);
    sfemi_delete(&m->allocator, g.start);
    sfemi_delete(&m->allocator, g.adjacent);
    return status;
}

SFEM_DEF sfem_status sfem_mesh_renumber(sfem_mesh *mesh, sfem_int *new_of_old, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    const sfem_allocator *a;
    sfem_int *old_of_new = NULL, *number = NULL, *tet = NULL, *lowest = NULL, *from = NULL;
    sfem_int *bucket = NULL, i, k;
    sfem_real *x = NULL;
    SFEM_ASSERT(mesh);
    a = &mesh->allocator;
    SFEMI_TRY(sfemi_mesh_in_range(mesh, err));
    if (mesh->tets > INT32_MAX / 4) {
        status =
            sfemi_fail(err, SFEM_TOO_LARGE, "%ld tets are too many to renumber", (long)mesh->tets);
        goto done;
    }
    SFEMI_NEW(sfem_int, old_of_new, a, mesh->nodes);
    SFEMI_NEW(sfem_int, number, a, mesh->nodes);
    SFEMI_NEW(sfem_int, bucket, a, (size_t)mesh->nodes + 1);
    SFEMI_NEW(sfem_int, tet, a, 4 * (size_t)mesh->tets);
    SFEMI_NEW(sfem_int, lowest, a, mesh->tets);
    SFEMI_NEW(sfem_int, from, a, mesh->tets);
    SFEMI_NEW(sfem_real, x, a, 3 * (size_t)mesh->nodes);
    SFEMI_TRY(sfemi_mesh_order(mesh, old_of_new, err));
    memcpy(x, mesh->x, 3 * (size_t)mesh->nodes * sizeof *x); /* nothing fails from here on */
    for (i = 0; i < mesh->nodes; ++i) {
        number[old_of_new[i]] = i;
        memcpy(mesh->x + 3 * (size_t)i, x + 3 * (size_t)old_of_new[i], 3 * sizeof *x);
    }
    for (i = 0; i < mesh->tets; ++i) {
        lowest[i] = mesh->nodes;
        for (k = 0; k < 4; ++k) {
            sfem_int v = number[mesh->tet[4 * (size_t)i + (size_t)k]];
            tet[4 * (size_t)i + (size_t)k] = v;
            if (v < lowest[i]) lowest[i] = v;
        }
    }
    sfemi_mesh_sort(lowest, 1, mesh->tets, mesh->nodes, NULL, from, bucket);
    for (i = 0; i < mesh->tets; ++i)
        memcpy(mesh->tet + 4 * (size_t)i, tet + 4 * (size_t)from[i], 4 * sizeof *tet);
    if (mesh->region) {
        memcpy(lowest, mesh->region, (size_t)mesh->tets * sizeof *lowest);
        for (i = 0; i < mesh->tets; ++i) mesh->region[i] = lowest[from[i]];
    }
    if (new_of_old) memcpy(new_of_old, number, (size_t)mesh->nodes * sizeof *number);
done:
    sfemi_delete(a, old_of_new);
    sfemi_delete(a, number);
    sfemi_delete(a, bucket);
    sfemi_delete(a, tet);
    sfemi_delete(a, lowest);
    sfemi_delete(a, from);
    sfemi_delete(a, x);
    return status;
}

SFEM_DEF sfem_int sfem_mesh_bandwidth(const sfem_mesh *mesh)
{
    sfem_int t, width = 0;
    int i;
    SFEM_ASSERT(mesh);
    for (t = 0; t < mesh->tets; ++t) {
        const sfem_int *v = mesh->tet + 4 * (size_t)t;
        sfem_int low = v[0], high = v[0];
        for (i = 1; i < 4; ++i) {
            if (v[i] < low) low = v[i];
            if (v[i] > high) high = v[i];
        }
        if (high - low > width) width = high - low;
    }
    return width;
}

SFEM_DEF sfem_status sfem_mesh_remove_unused(sfem_mesh *mesh, sfem_int *new_of_old, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfem_int *number = NULL, i, n = 0;
    size_t k;
    SFEM_ASSERT(mesh);
    SFEMI_TRY(sfemi_mesh_in_range(mesh, err));
    SFEMI_NEW(sfem_int, number, &mesh->allocator, mesh->nodes);
    for (k = 0; k < 4 * (size_t)mesh->tets; ++k) number[mesh->tet[k]] = 1;
    for (i = 0; i < mesh->nodes; ++i) {
        number[i] = number[i] ? n++ : -1;
        if (number[i] >= 0)
            memmove(mesh->x + 3 * (size_t)number[i], mesh->x + 3 * (size_t)i, 3 * sizeof *mesh->x);
    }
    for (k = 0; k < 4 * (size_t)mesh->tets; ++k) mesh->tet[k] = number[mesh->tet[k]];
    if (new_of_old) memcpy(new_of_old, number, (size_t)mesh->nodes * sizeof *number);
    mesh->nodes = n;
done:
    sfemi_delete(&mesh->allocator, number);
    return status;
}

/* ---- picking ---- */

#define SFEMI_MESH_INSIDE 1e-10 /* barycentric coordinates down to minus this count as inside */

/* Gradients of the barycentric coordinates of nodes 1, 2, 3 of a tet; 0 if it is flat. */
static int sfemi_mesh_gradients(const sfem_real *x, const sfem_int *tet, sfem_real g[3][3])
{
    const sfem_real *a = x + 3 * (size_t)tet[0];
    sfem_real e[3][3], det;
    int i, k;
    for (i = 0; i < 3; ++i) sfemi_sub3(x + 3 * (size_t)tet[i + 1], a, e[i]);
    for (i = 0; i < 3; ++i) sfemi_cross(e[(i + 1) % 3], e[(i + 2) % 3], g[i]);
    det = sfemi_dot3(g[0], e[0]);
    if (!sfemi_finite(1 / det)) return 0;
    for (i = 0; i < 3; ++i)
        for (k = 0; k < 3; ++k) g[i][k] /= det;
    return 1;
}

/* Barycentric coordinates of a point given relative to node 0, from the gradients. */
static void sfemi_mesh_barycentric(sfem_real g[3][3], const sfem_real *point, sfem_real b[4])
{
    int i;
    for (i = 0; i < 3; ++i) b[i + 1] = sfemi_dot3(g[i], point);
    b[0] = 1 - b[1] - b[2] - b[3];
}

/* Takes the rounding error out of coordinates that count as inside. */
static void sfemi_mesh_clamp(sfem_real b[4])
{
    sfem_real sum = 0;
    int i;
    for (i = 0; i < 4; ++i) {
        if (b[i] < 0) b[i] = 0;
        sum += b[i];
    }
    for (i = 0; i < 4; ++i) b[i] /= sum;
}

/* Is a point in the box round a tet? Most tets end here. */
static int sfemi_mesh_near(const sfem_real *x, const sfem_int *tet, const sfem_real *point)
{
    int i, k;
    for (k = 0; k < 3; ++k) {
        sfem_real low = x[3 * (size_t)tet[0] + (size_t)k], high = low, slack;
        for (i = 1; i < 4; ++i) {
            sfem_real v = x[3 * (size_t)tet[i] + (size_t)k];
            low = v < low ? v : low;
            high = v > high ? v : high;
        }
        slack = 4 * SFEMI_MESH_INSIDE * (high - low);
        if (point[k] < low - slack || point[k] > high + slack) return 0;
    }
    return 1;
}

SFEM_DEF int sfem_mesh_locate(const sfem_mesh *mesh, const sfem_real *x, const sfem_real point[3],
                              sfem_int *tet, sfem_real bary[4])
{
    sfem_real g[3][3], p[3], b[4], best[4], inside = -SFEMI_MESH_INSIDE, low;
    sfem_int t, found = -1;
    int i;
    SFEM_ASSERT(mesh && point);
    if (!x) x = mesh->x;
    if (!sfemi_all_finite(point, 3)) return 0;
    for (t = 0; t < mesh->tets; ++t) {
        const sfem_int *v = mesh->tet + 4 * (size_t)t;
        if (!sfemi_mesh_near(x, v, point) || !sfemi_mesh_gradients(x, v, g)) continue;
        sfemi_sub3(point, x + 3 * (size_t)v[0], p);
        sfemi_mesh_barycentric(g, p, b);
        low = b[0];
        for (i = 1; i < 4; ++i)
            if (b[i] < low) low = b[i];
        if (!(low > inside))
            continue; /* of tets that share the point, the one where it is deepest */
        inside = low;
        found = t;
        memcpy(best, b, sizeof best);
    }
    if (found < 0) return 0;
    sfemi_mesh_clamp(best);
    if (tet) *tet = found;
    if (bary) memcpy(bary, best, sizeof best);
    return 1;
}

/* Are the nodes of a tet on both sides of a plane through the origin of a ray? For two planes along
 * the ray that is what a tet needs that it meets. Tets that share nodes agree about them. */
static int sfemi_mesh_straddles(const sfem_real *x, const sfem_int *tet, const sfem_real *origin,
                                const sfem_real *normal)
{
    int i, above = 0, below = 0;
    for (i = 0; i < 4; ++i) {
        sfem_real p[3], side;
        sfemi_sub3(x + 3 * (size_t)tet[i], origin, p);
        side = sfemi_dot3(p, normal);
        above |= side >= 0;
        below |= side <= 0;
    }
    return above && below;
}

/* Where the ray origin + s direction, s >= 0, enters a tet, and b there; 0 if it passes by. */
static int sfemi_mesh_clip(const sfem_real *x, const sfem_int *tet, const sfem_real *origin,
                           const sfem_real *direction, sfem_real *enter, sfem_real b[4])
{
    sfem_real g[3][3], p[3], slope[4], leave = 0, s;
    int i, bounded = 0;
    if (!sfemi_mesh_gradients(x, tet, g)) return 0;
    sfemi_sub3(origin, x + 3 * (size_t)tet[0], p);
    sfemi_mesh_barycentric(g, p, b);
    for (i = 0; i < 3; ++i) slope[i + 1] = sfemi_dot3(g[i], direction);
    slope[0] = -slope[1] - slope[2] - slope[3];
    *enter = 0;
    for (i = 0; i < 4; ++i) { /* b + s slope >= -inside, for each of the four */
        if (b[i] < -SFEMI_MESH_INSIDE && slope[i] <= 0) return 0;
        if (slope[i] == 0) continue;
        s = (-SFEMI_MESH_INSIDE - b[i]) / slope[i];
        if (slope[i] > 0 && s > *enter) *enter = s;
        if (slope[i] < 0 && (!bounded || s < leave)) leave = s, bounded = 1;
    }
    if (bounded && leave < *enter) return 0;
    for (i = 0; i < 4; ++i) b[i] += *enter * slope[i];
    return 1;
}

SFEM_DEF int sfem_mesh_pick_ray(const sfem_mesh *mesh, const sfem_real *x,
                                const sfem_real origin[3], const sfem_real direction[3],
                                sfem_int *tet, sfem_real bary[4], sfem_real *distance)
{
    sfem_real unit[3], axis[3] = {0, 0, 0}, side[3], up[3];
    sfem_real b[4], best[4], enter, nearest = 0, length = 0;
    sfem_int t, found = -1;
    int i, k;
    SFEM_ASSERT(mesh && origin && direction);
    if (!x) x = mesh->x;
    for (i = 0; i < 3; ++i)
        if (fabs(direction[i]) > length) length = fabs(direction[i]);
    if (!(length > 0) || !sfemi_all_finite(direction, 3) || !sfemi_all_finite(origin, 3)) return 0;
    for (i = 0; i < 3; ++i) unit[i] = direction[i] / length; /* no under- or overflow in the norm */
    length = sqrt(sfemi_dot3(unit, unit));
    for (i = 0; i < 3; ++i) unit[i] /= length;
    k = fabs(unit[0]) < .6 ? 0 : fabs(unit[1]) < .6 ? 1 : 2; /* an axis not along the ray */
    axis[k] = 1;
    sfemi_cross(unit, axis, side);
    sfemi_cross(unit, side, up);
    for (t = 0; t < mesh->tets; ++t) {
        const sfem_int *v = mesh->tet + 4 * (size_t)t;
        if (!sfemi_mesh_straddles(x, v, origin, side) || !sfemi_mesh_straddles(x, v, origin, up) ||
            !sfemi_mesh_clip(x, v, origin, unit, &enter, b))
            continue;
        if (found >= 0 && enter >= nearest) continue;
        nearest = enter;
        found = t;
        memcpy(best, b, sizeof best);
    }
    if (found < 0) return 0;
    sfemi_mesh_clamp(best);
    if (tet) *tet = found;
    if (bary) memcpy(bary, best, sizeof best);
    if (distance) *distance = nearest;
    return 1;
}

/* ============================================================================================
 * >>meshio   readers and writers
 * ============================================================================================ */

/* Everything is parsed from memory between two pointers, so a file of any content can be read: a
 * count is believed only as far as the bytes behind it could hold that many things.
 *
 * LITERATURE. Clinger, How to read floating point numbers accurately, PLDI 1990. Gmsh reference
 * manual, MSH file format, version 4.1. The VTK file formats, for VTK 4.2 and later. */

/* ---- numbers as text, the same in any locale ---- */

#define SFEMI_DIGITS 800 /* more than 768 significant digits never change a rounding */
#define SFEMI_LIMBS  256 /* 800 digits shifted by 64 bits + 10^1130, the largest divisor */

typedef struct sfemi_big { /* a natural number, low limbs first, no zero limb on top */
    uint32_t limb[SFEMI_LIMBS];
    int n;
} sfemi_big;

static void sfemi_big_multiply_add(sfemi_big *b, uint32_t factor, uint32_t add)
{
    uint64_t carry = add;
    int i;
    for (i = 0; i < b->n; ++i) {
        carry += (uint64_t)b->limb[i] * factor;
        b->limb[i] = (uint32_t)carry;
        carry >>= 32;
    }
    if (carry) b->limb[b->n++] = (uint32_t)carry;
}

/* b = floor(b / divisor); returns 1 if there was a remainder. */
static int sfemi_big_divide(sfemi_big *b, uint32_t divisor)
{
    uint64_t rest = 0;
    int i;
    for (i = b->n; i-- > 0;) {
        rest = rest << 32 | b->limb[i];
        b->limb[i] = (uint32_t)(rest / divisor);
        rest %= divisor;
    }
    while (b->n > 0 && !b->limb[b->n - 1]) --b->n;
    return rest != 0;
}

static void sfemi_big_shift(sfemi_big *b, int bits)
{
    int i, words = bits / 32;
    if (b->n == 0) return;
    sfemi_big_multiply_add(b, (uint32_t)1 << bits % 32, 0);
    for (i = b->n; i-- > 0;) b->limb[i + words] = b->limb[i];
    for (i = 0; i < words; ++i) b->limb[i] = 0;
    b->n += words;
}

/* The double nearest to (b + a bit if sticky) 2^exponent, ties to even; b is above 0, and has more
 * than 53 bits if sticky. */
static sfem_real sfemi_big_round(const sfemi_big *b, int sticky, int exponent)
{
    int i, k, length = 32 * b->n, drop;
    uint64_t q = 0;
    sfem_real x;
    for (i = 31; !(b->limb[b->n - 1] >> i & 1); --i) --length;
    drop = length - 53;
    if (drop < -1074 - exponent) drop = -1074 - exponent; /* subnormal: fewer bits */
    if (drop < 0) drop = 0;
    for (i = b->n - 1; i >= drop / 32; --i) { /* b >> drop: 53 bits at most */
        k = 32 * i - drop;
        q |= k >= 0 ? (uint64_t)b->limb[i] << k : (uint64_t)b->limb[i] >> -k;
    }
    if (drop > 0 && (drop - 1) / 32 < b->n) {
        int half = (int)(b->limb[(drop - 1) / 32] >> (drop - 1) % 32 & 1);
        if (b->limb[(drop - 1) / 32] & (((uint32_t)1 << (drop - 1) % 32) - 1)) sticky = 1;
        for (i = 0; i < (drop - 1) / 32; ++i) sticky |= b->limb[i] != 0;
        q += (uint64_t)(half && (sticky || (q & 1)));
    }
    exponent += drop;
    for (; q < (uint64_t)1 << 52 && exponent > -1074; --exponent) q <<= 1;
    q += (uint64_t)(exponent + 1074) << 52; /* q's own top bit counts the exponent on by one */
    if (q > 0x7ff0000000000000u) q = 0x7ff0000000000000u;
    memcpy(&x, &q, sizeof x); /* arithmetic may flush subnormals, as -ffast-math has it */
    return x;
}

/* digits 10^exponent */
static sfem_real sfemi_big_scale(sfemi_big *b, int exponent, int sticky)
{
    int shift = 0;
    for (; exponent >= 9; exponent -= 9) sfemi_big_multiply_add(b, 1000000000u, 0);
    for (; exponent > 0; --exponent) sfemi_big_multiply_add(b, 10, 0);
    if (exponent < 0) { /* so far to the left that 64 bits remain: 3.322 > log2(10) */
        shift = 65 + -exponent * 3322 / 1000;
        sfemi_big_shift(b, shift);
    }
    for (; exponent <= -9; exponent += 9) sticky |= sfemi_big_divide(b, 1000000000u);
    for (; exponent < 0; ++exponent) sticky |= sfemi_big_divide(b, 10);
    return sfemi_big_round(b, sticky, -shift);
}

/* Reads [+-]digits[.digits][e[+-]digits]; returns where it ends, or NULL if that is not there. Too
 * large numbers give infinity. */
static const char *sfemi_text_real(const char *p, const char *end, sfem_real *out)
{
    sfemi_big b;
    int negative, any = 0, point = 0, digits = 0, sticky = 0, minus;
    int64_t exponent = 0, e = 0;
    b.n = 0;
    negative = p < end && *p == '-';
    if (p < end && (*p == '-' || *p == '+')) ++p;
    for (; p < end && ((*p >= '0' && *p <= '9') || (*p == '.' && !point)); ++p) {
        if (*p == '.') {
            point = 1;
            continue;
        }
        any = 1;
        exponent -= point;
        if (digits == SFEMI_DIGITS) {
            sticky |= *p != '0';
            ++exponent;
        } else if (*p != '0' || b.n) {
            sfemi_big_multiply_add(&b, 10, (uint32_t)(*p - '0'));
            ++digits;
        }
    }
    if (!any) return NULL;
    if (p < end && (*p == 'e' || *p == 'E')) {
        ++p;
        minus = p < end && *p == '-';
        if (p < end && (*p == '-' || *p == '+')) ++p;
        if (p == end || *p < '0' || *p > '9') return NULL;
        for (; p < end && *p >= '0' && *p <= '9'; ++p)
            if (e < INT64_MAX / 20) e = 10 * e + (*p - '0');
        exponent += minus ? -e : e;
    }
    if (!b.n || digits + exponent < -330)
        *out = 0;
    else if (digits + exponent > 310)
        *out = HUGE_VAL;
    else
        *out = sfemi_big_scale(&b, (int)exponent, sticky);
    if (negative) *out = -*out;
    return p;
}

/* ---- scanning ---- */

typedef struct sfemi_scan {
    const char *p, *end;
    sfem_int line; /* of p, from 1 */
    int in_row;    /* numbers are looked for up to the end of the line only */
    sfem_error *err;
} sfemi_scan;

SFEMI_PRINTF(3, 4)
static sfem_status sfemi_scan_fail(const sfemi_scan *s, sfem_status status, const char *format, ...)
{
    char text[180];
    va_list list;
    va_start(list, format);
    vsnprintf(text, sizeof text, format, list);
    va_end(list);
    sfemi_fail(s->err, status, "line %ld: %s", (long)s->line, text);
    if (s->err) s->err->line = s->line;
    return status;
}

static int sfemi_is_blank(char c) { return c == ' ' || (c >= '\t' && c <= '\r' && c != '\n'); }

static void sfemi_scan_space(sfemi_scan *s)
{
    for (; s->p < s->end; ++s->p) {
        if (*s->p == '\n') {
            if (s->in_row) return;
            if (s->line < INT32_MAX) ++s->line;
        } else if (!sfemi_is_blank(*s->p))
            return;
    }
}

static void sfemi_scan_skip_line(sfemi_scan *s)
{
    const char *p =
        s->p < s->end ? (const char *)memchr(s->p, '\n', (size_t)(s->end - s->p)) : NULL;
    s->p = p ? p + 1 : s->end;
    if (p && s->line < INT32_MAX) ++s->line;
}

/* The next word, of no letters at the end of the data (or of the line, in a row). */
typedef struct sfemi_word {
    const char *p;
    size_t n;
} sfemi_word;

static sfemi_word sfemi_scan_peek(sfemi_scan *s)
{
    sfemi_word w;
    const char *q;
    sfemi_scan_space(s);
    for (q = s->p; q < s->end && *q != '\n' && !sfemi_is_blank(*q); ++q) {
    }
    w.p = s->p;
    w.n = (size_t)(q - s->p);
    return w;
}

static sfemi_word sfemi_scan_word(sfemi_scan *s)
{
    sfemi_word w = sfemi_scan_peek(s);
    s->p += w.n;
    return w;
}

/* Is it this word? Capitals count as small letters. */
static int sfemi_word_is(sfemi_word w, const char *text)
{
    size_t i;
    for (i = 0; i < w.n; ++i) {
        char a = w.p[i], b = text[i];
        if (a >= 'A' && a <= 'Z') a = (char)(a - 'A' + 'a');
        if (b >= 'A' && b <= 'Z') b = (char)(b - 'A' + 'a');
        if (a != b || !b) return 0;
    }
    return text[w.n] == 0;
}

/* A word for a sentence: shortened, with nothing in it that is not printable. */
static const char *sfemi_word_text(sfemi_word w, char text[25])
{
    size_t i;
    for (i = 0; i < w.n && i < 24; ++i) text[i] = w.p[i] >= 32 && w.p[i] < 127 ? w.p[i] : '?';
    text[i] = 0;
    return text;
}

/* "expected a node tag, found 'x'" */
static sfem_status sfemi_scan_expected(sfemi_scan *s, const char *what, sfemi_word found)
{
    char text[25];
    if (!found.n)
        return sfemi_scan_fail(s, SFEM_FORMAT, "expected %s, but the %s ends", what,
                               s->in_row && s->p < s->end ? "line" : "data");
    return sfemi_scan_fail(s, SFEM_FORMAT, "expected %s, found '%s'", what,
                           sfemi_word_text(found, text));
}

static sfem_status sfemi_scan_integer(sfemi_scan *s, int64_t low, int64_t high, const char *what,
                                      int64_t *out)
{
    sfemi_word w = sfemi_scan_peek(s);
    size_t i = w.n && (w.p[0] == '-' || w.p[0] == '+');
    int negative = w.n && w.p[0] == '-';
    int64_t v = 0;
    if (i == w.n) return sfemi_scan_expected(s, what, w);
    for (; i < w.n; ++i) {
        if (w.p[i] < '0' || w.p[i] > '9') return sfemi_scan_expected(s, what, w);
        if (v > (INT64_MAX - 9) / 10)
            return sfemi_scan_fail(s, SFEM_FORMAT, "%s is too large a number", what);
        v = 10 * v + (w.p[i] - '0');
    }
    if (negative) v = -v;
    if (v < low || v > high)
        return sfemi_scan_fail(s, SFEM_FORMAT, "%s is %lld, not in %lld .. %lld", what,
                               (long long)v, (long long)low, (long long)high);
    s->p += w.n;
    *out = v;
    return SFEM_OK;
}

static sfem_status sfemi_scan_real(sfemi_scan *s, const char *what, sfem_real *out)
{
    sfemi_word w = sfemi_scan_peek(s);
    const char *q = sfemi_text_real(w.p, w.p + w.n, out);
    size_t sign = w.n && (w.p[0] == '-' || w.p[0] == '+');
    sfemi_word name;
    name.p = w.p + sign;
    name.n = w.n - sign;
    if (sfemi_word_is(name, "nan") || sfemi_word_is(name, "inf") || sfemi_word_is(name, "infinity"))
        return sfemi_scan_fail(s, SFEM_NOT_FINITE, "%s is not finite", what);
    if (q != w.p + w.n || !w.n) return sfemi_scan_expected(s, what, w);
    if (!sfemi_finite(*out))
        return sfemi_scan_fail(s, SFEM_NOT_FINITE, "%s is too large for a double", what);
    s->p += w.n;
    return SFEM_OK;
}

/* Nothing more on this line? */
static sfem_status sfemi_scan_end_of_row(sfemi_scan *s, const char *what)
{
    sfemi_word w;
    s->in_row = 1;
    w = sfemi_scan_peek(s);
    s->in_row = 0;
    return w.n ? sfemi_scan_expected(s, what, w) : SFEM_OK;
}

/* A count of things that take `each` bytes at least, of which there are no more than the data could
 * still hold, or an sfem_int. */
static sfem_status sfemi_scan_count(sfemi_scan *s, size_t each, const char *what, sfem_int *out)
{
    int64_t n;
    sfem_status status = sfemi_scan_integer(s, 0, INT64_MAX, what, &n);
    if (status != SFEM_OK) return status;
    if ((uint64_t)n > ((uint64_t)(s->end - s->p) + 1) / each)
        return sfemi_scan_fail(s, SFEM_FORMAT,
                               "%s is %lld, more than the rest of the data can hold", what,
                               (long long)n);
    if (n > INT32_MAX)
        return sfemi_scan_fail(s, SFEM_TOO_LARGE, "%s is %lld, above 2^31 - 1", what, (long long)n);
    *out = (sfem_int)n;
    return SFEM_OK;
}

/* ---- Gmsh 4.1 ASCII ---- */

/* A table from tags, any whole numbers, to 0, 1, 2.. in the order of their coming. */
typedef struct sfemi_tags {
    int64_t *tag;    /* [count] */
    sfem_int *table; /* [mask+1] place in tag plus 1, or 0 */
    size_t mask;
} sfemi_tags;

static sfem_status sfemi_tags_new(sfemi_tags *g, sfem_int count, const sfem_allocator *a,
                                  sfem_error *err)
{
    sfem_status status = SFEM_OK;
    size_t size = 16;
    while (size < 2 * (size_t)count) size *= 2;
    SFEMI_NEW(int64_t, g->tag, a, count);
    SFEMI_NEW(sfem_int, g->table, a, size);
    g->mask = size - 1;
done:
    return status; /* the caller frees what there is */
}

static void sfemi_tags_free(sfemi_tags *g, const sfem_allocator *a)
{
    sfemi_delete(a, g->tag);
    sfemi_delete(a, g->table);
}

/* The slot of a tag, or the empty one where it would go. */
static sfem_int *sfemi_tags_slot(const sfemi_tags *g, int64_t tag)
{
    uint64_t h = (uint64_t)tag * 0x9e3779b97f4a7c15u;
    size_t i = (size_t)(h ^ h >> 32) & g->mask;
    while (g->table[i] && g->tag[g->table[i] - 1] != tag) i = (i + 1) & g->mask;
    return g->table + i;
}

typedef struct sfemi_gmsh {
    sfemi_scan s;
    sfem_mesh m;
    sfemi_tags node, volume;
    sfem_int volumes, *group; /* [volumes] first physical group, or 0 */
    int any_group, has_format, has_nodes, has_elements;
} sfemi_gmsh;

static sfem_status sfemi_gmsh_end(sfemi_gmsh *g, const char *end)
{
    sfemi_word w = sfemi_scan_peek(&g->s);
    if (!sfemi_word_is(w, end)) return sfemi_scan_expected(&g->s, end, w);
    g->s.p += w.n;
    return SFEM_OK;
}

static sfem_status sfemi_gmsh_format(sfemi_gmsh *g)
{
    sfemi_scan *s = &g->s;
    sfemi_word w = sfemi_scan_peek(s);
    sfem_status status;
    sfem_real version;
    int64_t binary, size;
    char text[25];
    if (sfemi_text_real(w.p, w.p + w.n, &version) != w.p + w.n)
        return sfemi_scan_expected(s, "a Gmsh version", w);
    if (!sfemi_word_is(w, "4.1"))
        return sfemi_scan_fail(s, SFEM_FORMAT, "Gmsh %s: only 4.1 ASCII is read",
                               sfemi_word_text(w, text));
    s->p += w.n;
    SFEMI_TRY(sfemi_scan_integer(s, 0, 1, "the file type (0 ASCII, 1 binary)", &binary));
    if (binary) return sfemi_scan_fail(s, SFEM_FORMAT, "Gmsh 4.1 binary: only 4.1 ASCII is read");
    SFEMI_TRY(sfemi_scan_integer(s, 1, 64, "the data size", &size));
    SFEMI_TRY(sfemi_gmsh_end(g, "$EndMeshFormat"));
    g->has_format = 1;
done:
    return status;
}

/* One volume: tag, box, physical groups, bounding surfaces. */
static sfem_status sfemi_gmsh_volume(sfemi_gmsh *g, sfem_int i)
{
    sfemi_scan *s = &g->s;
    sfem_status status;
    sfem_int *slot;
    sfem_real x;
    int64_t v, groups, group = 0;
    int k;
    sfemi_scan_space(s);
    s->in_row = 1;
    SFEMI_TRY(sfemi_scan_integer(s, -INT32_MAX, INT32_MAX, "a volume tag", &v));
    for (k = 0; k < 6; ++k) SFEMI_TRY(sfemi_scan_real(s, "a bound of the volume", &x));
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT32_MAX, "a count of physical groups", &groups));
    if (groups > 0)
        SFEMI_TRY(sfemi_scan_integer(s, -INT32_MAX, INT32_MAX, "a physical group", &group));
    g->volume.tag[i] = v;
    slot = sfemi_tags_slot(&g->volume, v);
    if (*slot) {
        status = sfemi_scan_fail(s, SFEM_FORMAT, "volume %ld a second time", (long)v);
        goto done;
    }
    *slot = i + 1;
    g->group[i] = (sfem_int)(group < 0 ? -group : group); /* a sign only tells the orientation */
    if (groups > 0) g->any_group = 1;
    sfemi_scan_skip_line(s);
done:
    s->in_row = 0;
    return status;
}

static sfem_status sfemi_gmsh_entities(sfemi_gmsh *g)
{
    static const char *const what[4] = {"the count of points", "the count of curves",
                                        "the count of surfaces", "the count of volumes"};
    sfemi_scan *s = &g->s;
    sfem_error *err = s->err;
    sfem_status status = SFEM_OK;
    sfem_int count[4], i;
    int k;
    if (g->group) return sfemi_scan_fail(s, SFEM_FORMAT, "a second $Entities section");
    for (k = 0; k < 4; ++k) SFEMI_TRY(sfemi_scan_count(s, 8, what[k], &count[k]));
    SFEMI_TRY(sfemi_tags_new(&g->volume, count[3], &g->m.allocator, err));
    SFEMI_NEW(sfem_int, g->group, &g->m.allocator, count[3]);
    g->volumes = count[3];
    for (k = 0; k < 3; ++k)
        for (i = 0; i < count[k]; ++i) {
            sfemi_word w = sfemi_scan_peek(s);
            if (!w.n || *w.p == '$') return sfemi_scan_expected(s, "another entity", w);
            sfemi_scan_skip_line(s);
        }
    for (i = 0; i < count[3]; ++i) SFEMI_TRY(sfemi_gmsh_volume(g, i));
    SFEMI_TRY(sfemi_gmsh_end(g, "$EndEntities"));
done:
    return status;
}

/* One block of nodes: all their tags, then all their places. */
static sfem_status sfemi_gmsh_node_block(sfemi_gmsh *g, sfem_int first, sfem_int *n)
{
    sfemi_scan *s = &g->s;
    sfem_status status;
    sfem_int i, count = 0;
    int64_t dimension, v, parametric;
    int k;
    SFEMI_TRY(sfemi_scan_integer(s, 0, 3, "the dimension of an entity", &dimension));
    SFEMI_TRY(sfemi_scan_integer(s, INT32_MIN, INT32_MAX, "the tag of an entity", &v));
    SFEMI_TRY(sfemi_scan_integer(s, 0, 1, "'parametric' (0 or 1)", &parametric));
    SFEMI_TRY(sfemi_scan_count(s, 8, "the count of nodes in a block", &count));
    if (count > g->m.nodes - first) {
        status = sfemi_scan_fail(
            s, SFEM_FORMAT, "the blocks have more than the %ld nodes announced", (long)g->m.nodes);
        goto done;
    }
    for (i = first; i < first + count; ++i) {
        sfem_int *slot;
        SFEMI_TRY(sfemi_scan_integer(s, 1, INT64_MAX, "a node tag", &v));
        g->node.tag[i] = v;
        slot = sfemi_tags_slot(&g->node, v);
        if (*slot) {
            status = sfemi_scan_fail(s, SFEM_FORMAT, "node tag %lld a second time", (long long)v);
            goto done;
        }
        *slot = i + 1;
    }
    for (i = first; i < first + count; ++i) {
        sfem_real ignored;
        sfemi_scan_space(s);
        s->in_row = 1;
        for (k = 0; k < 3; ++k)
            SFEMI_TRY(sfemi_scan_real(s, "a coordinate", g->m.x + 3 * (size_t)i + k));
        for (k = 0; k < (parametric ? (int)dimension : 0); ++k)
            SFEMI_TRY(sfemi_scan_real(s, "a parametric coordinate", &ignored));
        SFEMI_TRY(sfemi_scan_end_of_row(s, "the end of the line"));
    }
    *n = count;
done:
    s->in_row = 0;
    return status;
}

static sfem_status sfemi_gmsh_nodes(sfemi_gmsh *g)
{
    sfemi_scan *s = &g->s;
    sfem_error *err = s->err;
    sfem_status status = SFEM_OK;
    sfem_int nodes = 0, n = 0, filled = 0;
    int64_t blocks, v;
    if (g->has_nodes) return sfemi_scan_fail(s, SFEM_FORMAT, "a second $Nodes section");
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT64_MAX, "the count of node blocks", &blocks));
    SFEMI_TRY(sfemi_scan_count(s, 8, "the count of nodes", &nodes));
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT64_MAX, "the lowest node tag", &v));
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT64_MAX, "the highest node tag", &v));
    SFEMI_NEW(sfem_real, g->m.x, &g->m.allocator, 3 * (size_t)nodes);
    SFEMI_TRY(sfemi_tags_new(&g->node, nodes, &g->m.allocator, err));
    g->m.nodes = nodes;
    for (; blocks > 0; --blocks) {
        SFEMI_TRY(sfemi_gmsh_node_block(g, filled, &n));
        filled += n;
    }
    SFEMI_TRY(sfemi_gmsh_end(g, "$EndNodes"));
    if (filled != nodes) {
        status = sfemi_scan_fail(s, SFEM_FORMAT, "%ld nodes announced, %ld found", (long)nodes,
                                 (long)filled);
        goto done;
    }
    g->has_nodes = 1;
done:
    return status;
}

/* Tet number t from its row: tag and four node tags. */
static sfem_status sfemi_gmsh_tet(sfemi_gmsh *g, sfem_int t)
{
    sfemi_scan *s = &g->s;
    sfem_status status;
    int64_t v;
    int k;
    s->in_row = 1;
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT64_MAX, "an element tag", &v));
    for (k = 0; k < 4; ++k) {
        sfem_int slot;
        SFEMI_TRY(sfemi_scan_integer(s, INT64_MIN, INT64_MAX, "a node tag of a tet", &v));
        slot = *sfemi_tags_slot(&g->node, v);
        if (!slot) {
            status =
                sfemi_scan_fail(s, SFEM_BAD_MESH, "tet %ld names node tag %lld, which is not there",
                                (long)t, (long long)v);
            if (s->err) s->err->tet = t;
            goto done;
        }
        g->m.tet[4 * (size_t)t + (size_t)k] = slot - 1;
    }
    SFEMI_TRY(sfemi_scan_end_of_row(s, "the end of the tet's line"));
done:
    s->in_row = 0;
    return status;
}

/* One block of elements. First they are only counted: g->m.tet is NULL then. */
static sfem_status sfemi_gmsh_element_block(sfemi_gmsh *g, int64_t *elements, sfem_int *tets)
{
    sfemi_scan *s = &g->s;
    sfem_status status;
    sfem_int slot, region;
    int64_t dimension, entity, type, count, i;
    SFEMI_TRY(sfemi_scan_integer(s, 0, 3, "the dimension of an entity", &dimension));
    SFEMI_TRY(sfemi_scan_integer(s, -INT32_MAX, INT32_MAX, "the tag of an entity", &entity));
    SFEMI_TRY(sfemi_scan_integer(s, 1, INT32_MAX, "an element type", &type));
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT64_MAX, "the count of elements in a block", &count));
    region = (sfem_int)entity;
    if (g->any_group) {
        slot = *sfemi_tags_slot(&g->volume, entity);
        region = slot ? g->group[slot - 1] : 0;
    }
    for (i = 0; i < count; ++i) {
        sfemi_word w = sfemi_scan_peek(s);
        if (!w.n || *w.p == '$') {
            status = sfemi_scan_expected(s, "another element", w);
            goto done;
        }
        if (type == 4 && *tets == INT32_MAX) {
            status = sfemi_scan_fail(s, SFEM_TOO_LARGE, "more than 2^31 - 1 tets");
            goto done;
        }
        if (type == 4 && g->m.tet) {
            SFEMI_TRY(sfemi_gmsh_tet(g, *tets));
            g->m.region[*tets] = region;
        } else
            sfemi_scan_skip_line(s);
        *tets += type == 4;
    }
    *elements += count;
done:
    return status;
}

static sfem_status sfemi_gmsh_elements(sfemi_gmsh *g)
{
    sfemi_scan *s = &g->s, start;
    sfem_error *err = s->err;
    sfem_status status = SFEM_OK;
    sfem_int tets = 0;
    int64_t blocks, elements, v, b, found = 0;
    if (g->has_elements) return sfemi_scan_fail(s, SFEM_FORMAT, "a second $Elements section");
    if (!g->has_nodes) return sfemi_scan_fail(s, SFEM_FORMAT, "$Elements come before $Nodes");
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT64_MAX, "the count of element blocks", &blocks));
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT64_MAX, "the count of elements", &elements));
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT64_MAX, "the lowest element tag", &v));
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT64_MAX, "the highest element tag", &v));
    start = *s;
    for (b = 0; b < blocks; ++b) SFEMI_TRY(sfemi_gmsh_element_block(g, &found, &tets));
    SFEMI_TRY(sfemi_gmsh_end(g, "$EndElements"));
    if (found != elements) {
        status = sfemi_scan_fail(s, SFEM_FORMAT, "%lld elements announced, %lld found",
                                 (long long)elements, (long long)found);
        goto done;
    }
    SFEMI_NEW(sfem_int, g->m.tet, &g->m.allocator, 4 * (size_t)tets);
    SFEMI_NEW(sfem_int, g->m.region, &g->m.allocator, tets);
    *s = start;
    for (b = 0; b < blocks; ++b) SFEMI_TRY(sfemi_gmsh_element_block(g, &found, &g->m.tets));
    SFEMI_TRY(sfemi_gmsh_end(g, "$EndElements"));
    g->has_elements = 1;
done:
    return status;
}

/* Goes past the line $End<name> of section $<name>. */
static sfem_status sfemi_gmsh_skip(sfemi_gmsh *g, sfemi_word name)
{
    sfemi_scan *s = &g->s;
    sfemi_word w;
    while (s->p < s->end) {
        w = sfemi_scan_peek(s);
        if (w.n == name.n + 3 && !memcmp(w.p, "$End", 4) &&
            !memcmp(w.p + 4, name.p + 1, name.n - 1)) {
            s->p += w.n;
            return SFEM_OK;
        }
        sfemi_scan_skip_line(s);
    }
    w.n = 0;
    return sfemi_scan_expected(s, "the end of the section", w);
}

static sfem_status sfemi_gmsh_read(sfemi_gmsh *g)
{
    sfemi_scan *s = &g->s;
    sfem_status status = SFEM_OK;
    sfemi_word w;
    while (status == SFEM_OK && (w = sfemi_scan_word(s)).n) {
        if (*w.p != '$') return sfemi_scan_expected(s, "a section like $Nodes", w);
        if (sfemi_word_is(w, "$MeshFormat"))
            status = sfemi_gmsh_format(g);
        else if (!g->has_format)
            return sfemi_scan_expected(s, "$MeshFormat", w);
        else if (sfemi_word_is(w, "$Entities"))
            status = sfemi_gmsh_entities(g);
        else if (sfemi_word_is(w, "$Nodes"))
            status = sfemi_gmsh_nodes(g);
        else if (sfemi_word_is(w, "$Elements"))
            status = sfemi_gmsh_elements(g);
        else
            status = sfemi_gmsh_skip(g, w);
    }
    if (status == SFEM_OK && !g->has_elements)
        status = sfemi_scan_fail(s, SFEM_FORMAT, "the data ends before $Nodes and $Elements");
    return status;
}

/* ---- VTK legacy ASCII ---- */

typedef struct sfemi_vtk {
    sfemi_scan s;
    sfem_mesh m;
    sfemi_scan cell_scan;    /* the numbers behind CELLS, or behind CONNECTIVITY */
    sfem_int cells, *offset; /* [cells+1] where each cell's nodes begin, in 5.1 */
    sfem_int numbers;        /* how many stand there */
    unsigned char *type;     /* [cells] 255 for any type above */
    int has_points, has_cells, has_types;
} sfemi_vtk;

static sfem_status sfemi_vtk_header(sfemi_vtk *r)
{
    sfemi_scan *s = &r->s;
    sfemi_word w;
    sfem_real version;
    char text[25];
    int k;
    for (k = 0; k < 4; ++k) sfemi_scan_word(s); /* "# vtk DataFile Version" is what led here */
    s->in_row = 1;
    w = sfemi_scan_peek(s);
    s->in_row = 0;
    if (!w.n || sfemi_text_real(w.p, w.p + w.n, &version) != w.p + w.n)
        return sfemi_scan_expected(s, "a VTK version", w);
    if (version < 1 || version >= 6)
        return sfemi_scan_fail(s, SFEM_FORMAT, "VTK legacy %s: only 1.0 to 5.1 are read",
                               sfemi_word_text(w, text));
    sfemi_scan_skip_line(s);
    sfemi_scan_skip_line(s); /* the title, which may be empty */
    w = sfemi_scan_peek(s);
    if (sfemi_word_is(w, "BINARY"))
        return sfemi_scan_fail(s, SFEM_FORMAT, "VTK legacy binary: only ASCII is read");
    if (!sfemi_word_is(w, "ASCII")) return sfemi_scan_expected(s, "ASCII", w);
    s->p += w.n;
    return SFEM_OK;
}

static sfem_status sfemi_vtk_skip_words(sfemi_scan *s, int64_t count, const char *what)
{
    for (; count > 0; --count) {
        sfemi_word w = sfemi_scan_word(s);
        if (!w.n) return sfemi_scan_expected(s, what, w);
    }
    return SFEM_OK;
}

static sfem_status sfemi_vtk_points(sfemi_vtk *r)
{
    sfemi_scan *s = &r->s;
    sfem_error *err = s->err;
    sfem_status status = SFEM_OK;
    sfem_int n = 0;
    size_t i;
    if (r->has_points) return sfemi_scan_fail(s, SFEM_FORMAT, "POINTS a second time");
    SFEMI_TRY(sfemi_scan_count(s, 6, "the count of points", &n));
    SFEMI_TRY(sfemi_vtk_skip_words(s, 1, "the type of the points"));
    SFEMI_NEW(sfem_real, r->m.x, &r->m.allocator, 3 * (size_t)n);
    for (i = 0; i < 3 * (size_t)n; ++i) SFEMI_TRY(sfemi_scan_real(s, "a coordinate", r->m.x + i));
    r->m.nodes = n;
    r->has_points = 1;
done:
    return status;
}

/* CELLS n size, then rows of a count and as many nodes; from 5.1 on CELLS n+1 size, then OFFSETS
 * and CONNECTIVITY. Cells are looked at when their types are known: here they are only passed
 * over. */
static sfem_status sfemi_vtk_cells(sfemi_vtk *r)
{
    sfemi_scan *s = &r->s;
    sfem_error *err = s->err;
    sfem_status status = SFEM_OK;
    sfem_int n = 0, i;
    int64_t v, before = 0;
    if (r->has_cells) return sfemi_scan_fail(s, SFEM_FORMAT, "CELLS a second time");
    SFEMI_TRY(sfemi_scan_count(s, 2, "the count of cells", &n));
    SFEMI_TRY(sfemi_scan_count(s, 2, "the count of numbers in CELLS", &r->numbers));
    if (sfemi_word_is(sfemi_scan_peek(s), "OFFSETS")) {
        SFEMI_TRY(sfemi_vtk_skip_words(s, 2, "the type of the offsets"));
        SFEMI_NEW(sfem_int, r->offset, &r->m.allocator, n);
        for (i = 0; i < n; ++i) {
            SFEMI_TRY(sfemi_scan_integer(s, before, i ? r->numbers : 0, "an offset", &v));
            r->offset[i] = (sfem_int)v;
            before = v;
        }
        if (n && before != r->numbers) {
            status = sfemi_scan_fail(s, SFEM_FORMAT, "the last offset is %lld, not %ld",
                                     (long long)before, (long)r->numbers);
            goto done;
        }
        if (!sfemi_word_is(sfemi_scan_peek(s), "CONNECTIVITY")) {
            status = sfemi_scan_expected(s, "CONNECTIVITY", sfemi_scan_peek(s));
            goto done;
        }
        SFEMI_TRY(sfemi_vtk_skip_words(s, 2, "the type of the connectivity"));
        n -= n > 0;
    }
    r->cells = n;
    r->cell_scan = *s;
    SFEMI_TRY(sfemi_vtk_skip_words(s, r->numbers, "another number of a cell"));
    r->has_cells = 1;
done:
    return status;
}

static sfem_status sfemi_vtk_types(sfemi_vtk *r)
{
    sfemi_scan *s = &r->s;
    sfem_error *err = s->err;
    sfem_status status = SFEM_OK;
    sfem_int n = 0, i;
    int64_t v;
    if (r->has_types) return sfemi_scan_fail(s, SFEM_FORMAT, "CELL_TYPES a second time");
    if (!r->has_cells) return sfemi_scan_fail(s, SFEM_FORMAT, "CELL_TYPES come before CELLS");
    SFEMI_TRY(sfemi_scan_count(s, 2, "the count of cell types", &n));
    if (n != r->cells) {
        status = sfemi_scan_fail(s, SFEM_FORMAT, "%ld cell types for %ld cells", (long)n,
                                 (long)r->cells);
        goto done;
    }
    SFEMI_NEW(unsigned char, r->type, &r->m.allocator, n);
    for (i = 0; i < n; ++i) {
        SFEMI_TRY(sfemi_scan_integer(s, 0, INT32_MAX, "a cell type", &v));
        r->type[i] = (unsigned char)(v < 255 ? v : 255);
    }
    r->has_types = 1;
done:
    return status;
}

/* FIELD name count, then so many arrays: name, components, tuples, type, values. */
static sfem_status sfemi_vtk_field(sfemi_scan *s)
{
    sfem_status status;
    int64_t arrays, components, tuples;
    SFEMI_TRY(sfemi_vtk_skip_words(s, 1, "the name of a field"));
    SFEMI_TRY(sfemi_scan_integer(s, 0, INT32_MAX, "the count of arrays in a field", &arrays));
    for (; arrays > 0; --arrays) {
        SFEMI_TRY(sfemi_vtk_skip_words(s, 1, "the name of an array"));
        SFEMI_TRY(sfemi_scan_integer(s, 0, INT32_MAX, "a count of components", &components));
        SFEMI_TRY(sfemi_scan_integer(s, 0, INT32_MAX, "a count of tuples", &tuples));
        SFEMI_TRY(sfemi_vtk_skip_words(s, 1, "the type of an array"));
        SFEMI_TRY(sfemi_vtk_skip_words(s, components * tuples, "another value of an array"));
    }
done:
    return status;
}

/* A METADATA block ends with an empty line. */
static void sfemi_vtk_skip_metadata(sfemi_scan *s)
{
    sfemi_word w;
    do {
        sfemi_scan_skip_line(s);
        s->in_row = 1;
        w = sfemi_scan_peek(s);
        s->in_row = 0;
    } while (w.n);
}

/* Nodes of a cell of a fixed shape, by type; 0 = any number. */
static int sfemi_vtk_cell_nodes(int type)
{
    static const unsigned char nodes[15] = {0, 1, 0, 2, 0, 3, 0, 0, 4, 4, 4, 8, 8, 6, 5};
    return type < 15 ? nodes[type] : 0;
}

/* The tets among the cells. */
static sfem_status sfemi_vtk_tets(sfemi_vtk *r)
{
    sfemi_scan *s = &r->cell_scan;
    sfem_error *err = s->err;
    sfem_status status = SFEM_OK;
    sfem_int i, t = 0, left = r->numbers;
    int64_t nodes, v;
    for (i = 0; i < r->cells; ++i) t += r->type[i] == 10;
    SFEMI_NEW(sfem_int, r->m.tet, &r->m.allocator, 4 * (size_t)t);
    for (i = 0; i < r->cells; ++i) {
        int wanted = sfemi_vtk_cell_nodes(r->type[i]);
        if (r->offset)
            nodes = r->offset[i + 1] - r->offset[i];
        else {
            if (left < 1) {
                status = sfemi_scan_fail(s, SFEM_FORMAT, "CELLS end in cell %ld of %ld", (long)i,
                                         (long)r->cells);
                goto done;
            }
            SFEMI_TRY(sfemi_scan_integer(s, 0, left - 1, "the count of nodes of a cell", &nodes));
            --left;
        }
        if (wanted && nodes != wanted) {
            sfemi_scan_space(s);
            status = sfemi_scan_fail(s, SFEM_FORMAT, "cell %ld of type %d has %lld nodes, not %d",
                                     (long)i, r->type[i], (long long)nodes, wanted);
            goto done;
        }
        left -= (sfem_int)nodes;
        if (r->type[i] != 10) {
            SFEMI_TRY(sfemi_vtk_skip_words(s, nodes, "another number of a cell"));
            continue;
        }
        for (; nodes > 0; --nodes) {
            SFEMI_TRY(sfemi_scan_integer(s, INT64_MIN, INT64_MAX, "a node of a tet", &v));
            if (v < 0 || v >= r->m.nodes) {
                status =
                    sfemi_scan_fail(s, SFEM_BAD_MESH, "tet %ld names node %lld, the mesh has %ld",
                                    (long)r->m.tets, (long long)v, (long)r->m.nodes);
                if (s->err) s->err->tet = r->m.tets;
                goto done;
            }
            r->m.tet[4 * (size_t)r->m.tets + (size_t)(4 - nodes)] = (sfem_int)v;
        }
        ++r->m.tets;
    }
    if (left)
        status = sfemi_scan_fail(s, SFEM_FORMAT, "CELLS have %ld numbers too many", (long)left);
done:
    return status;
}

static sfem_status sfemi_vtk_read(sfemi_vtk *r)
{
    sfemi_scan *s = &r->s;
    sfemi_word w;
    sfem_status status = sfemi_vtk_header(r);
    int has_dataset = 0;
    while (status == SFEM_OK && (w = sfemi_scan_word(s)).n) {
        if (sfemi_word_is(w, "DATASET")) {
            w = sfemi_scan_peek(s);
            if (!sfemi_word_is(w, "UNSTRUCTURED_GRID"))
                return sfemi_scan_expected(s, "UNSTRUCTURED_GRID", w);
            s->p += w.n;
            has_dataset = 1;
        } else if (sfemi_word_is(w, "FIELD"))
            status = sfemi_vtk_field(s);
        else if (sfemi_word_is(w, "METADATA"))
            sfemi_vtk_skip_metadata(s);
        else if (!has_dataset)
            return sfemi_scan_expected(s, "DATASET", w);
        else if (sfemi_word_is(w, "POINTS"))
            status = sfemi_vtk_points(r);
        else if (sfemi_word_is(w, "CELLS"))
            status = sfemi_vtk_cells(r);
        else if (sfemi_word_is(w, "CELL_TYPES"))
            status = sfemi_vtk_types(r);
        else if (sfemi_word_is(w, "POINT_DATA") || sfemi_word_is(w, "CELL_DATA"))
            break;
        else
            return sfemi_scan_expected(s, "POINTS, CELLS or CELL_TYPES", w);
    }
    if (status != SFEM_OK) return status;
    if (!r->has_points || !r->has_types)
        return sfemi_scan_fail(s, SFEM_FORMAT, "there are no %s",
                               !r->has_points ? "POINTS"
                               : r->has_cells ? "CELL_TYPES"
                                              : "CELLS");
    return sfemi_vtk_tets(r);
}

/* ---- either ---- */

static sfem_status sfemi_mesh_parse_gmsh(const sfemi_scan *s, const sfem_allocator *a,
                                         sfem_mesh *out)
{
    sfemi_gmsh g;
    sfem_status status;
    memset(&g, 0, sizeof g);
    g.s = *s;
    g.m.allocator = *a;
    status = sfemi_gmsh_read(&g);
    sfemi_tags_free(&g.node, a);
    sfemi_tags_free(&g.volume, a);
    sfemi_delete(a, g.group);
    *out = g.m;
    return status;
}

static sfem_status sfemi_mesh_parse_vtk(const sfemi_scan *s, const sfem_allocator *a,
                                        sfem_mesh *out)
{
    sfemi_vtk r;
    sfem_status status;
    memset(&r, 0, sizeof r);
    r.s = *s;
    r.m.allocator = *a;
    status = sfemi_vtk_read(&r);
    sfemi_delete(a, r.offset);
    sfemi_delete(a, r.type);
    *out = r.m;
    return status;
}

static int sfemi_scan_begins(const sfemi_scan *s, const char *text)
{
    sfemi_word w;
    w.p = s->p;
    w.n = strlen(text);
    return (size_t)(s->end - s->p) >= w.n && sfemi_word_is(w, text);
}

SFEM_DEF sfem_status sfem_mesh_parse(const void *data, size_t bytes,
                                     const sfem_allocator *allocator, sfem_mesh *out,
                                     sfem_error *err)
{
    sfem_status status;
    char begin[25];
    sfem_allocator a;
    sfem_mesh m;
    sfemi_scan s;
    SFEM_ASSERT(out && (data || !bytes));
    memset(&a, 0, sizeof a);
    memset(&m, 0, sizeof m);
    memset(&s, 0, sizeof s);
    if (allocator) a = *allocator;
    s.p = bytes ? (const char *)data : "";
    s.end = s.p + bytes;
    s.line = 1;
    s.err = err;
    if (sfemi_scan_begins(&s, "\xef\xbb\xbf")) s.p += 3; /* a byte order mark */
    sfemi_scan_space(&s);
    if (sfemi_scan_begins(&s, "$"))
        status = sfemi_mesh_parse_gmsh(&s, &a, &m);
    else if (sfemi_scan_begins(&s, "# vtk DataFile Version"))
        status = sfemi_mesh_parse_vtk(&s, &a, &m);
    else if (s.p == s.end)
        status = sfemi_scan_fail(&s, SFEM_FORMAT, "there is no data");
    else
        status = sfemi_scan_fail(&s, SFEM_FORMAT,
                                 "only Gmsh 4.1 ASCII and VTK legacy ASCII are read, this begins "
                                 "with '%s'",
                                 sfemi_word_text(sfemi_scan_peek(&s), begin));
    if (status == SFEM_OK && m.tets < 1)
        status = sfemi_fail(err, SFEM_BAD_MESH, "there are %ld nodes, but no 4-node tets",
                            (long)m.nodes);
    if (status == SFEM_OK) {
        sfem_mesh_orient(&m);
        *out = m;
    } else
        sfem_mesh_free(&m);
    return status;
}

#ifndef SFEM_NO_STDIO

/* ---- files ---- */

/* "path: text", with the system's reason if there is one. */
static sfem_status sfemi_file_fail(const char *path, const char *text, sfem_error *err)
{
    const char *reason = errno ? strerror(errno) : "no reason given";
    return sfemi_fail(err, SFEM_IO, "%.120s: %s (%.60s)", path, text, reason);
}

/* The whole file, in a buffer that doubles. */
static sfem_status sfemi_file_read(const char *path, const sfem_allocator *a, char **out,
                                   size_t *bytes, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    char *buffer = NULL, *larger = NULL;
    size_t size = 65536, n = 0, got;
    FILE *f;
    errno = 0;
    f = fopen(path, "rb");
    if (!f) return sfemi_file_fail(path, "cannot be opened", err);
    SFEMI_NEW(char, buffer, a, size);
    while ((got = fread(buffer + n, 1, size - n, f)) > 0) {
        n += got;
        if (n < size) continue;
        if (size > (size_t)-1 / 2) {
            status = sfemi_fail(err, SFEM_TOO_LARGE, "%.120s: too large a file", path);
            goto done;
        }
        SFEMI_NEW(char, larger, a, 2 * size);
        memcpy(larger, buffer, n);
        sfemi_delete(a, buffer);
        buffer = larger;
        larger = NULL;
        size *= 2;
    }
    if (ferror(f)) {
        status = sfemi_file_fail(path, "cannot be read", err);
        goto done;
    }
    *out = buffer;
    *bytes = n;
    buffer = NULL;
done:
    sfemi_delete(a, buffer);
    fclose(f);
    return status;
}

SFEM_DEF sfem_status sfem_mesh_read(const char *path, const sfem_allocator *allocator,
                                    sfem_mesh *out, sfem_error *err)
{
    sfem_allocator a;
    sfem_status status;
    char *data = NULL;
    size_t bytes = 0;
    SFEM_ASSERT(path && out);
    memset(&a, 0, sizeof a);
    if (allocator) a = *allocator;
    status = sfemi_file_read(path, &a, &data, &bytes, err);
    if (status != SFEM_OK) return status;
    status = sfem_mesh_parse(data, bytes, &a, out, err);
    sfemi_delete(&a, data);
    if (status != SFEM_OK && err) { /* put the path in front */
        sfem_error e = *err;
        sfemi_fail_at(err, status, e.node, e.tet, "%.100s: %.135s", path, e.text);
        err->line = e.line;
    }
    return status;
}

/* Closes a file that was written; tells if any of it failed. */
static sfem_status sfemi_file_close(FILE *f, const char *path, sfem_error *err)
{
    int failed = fflush(f) != 0;
    failed |= ferror(f) != 0;
    if (!failed) return fclose(f) ? sfemi_file_fail(path, "cannot be written", err) : SFEM_OK;
    sfemi_file_fail(path, "cannot be written", err); /* while errno still says why */
    fclose(f);
    return SFEM_IO;
}

static sfem_status sfemi_file_create(const char *path, FILE **f, sfem_error *err)
{
    errno = 0;
    *f = fopen(path, "wb");
    return *f ? SFEM_OK : sfemi_file_fail(path, "cannot be opened for writing", err);
}

/* Writes x with 15 or 17 digits and a point, whatever the locale's is, and `after` it. */
static void sfemi_file_real(FILE *f, sfem_real x, const char *after)
{
    char text[64], *p, *q;
    sfem_real back;
    int digits, n;
    for (digits = 15; digits <= 17; digits += 2) {
        n = snprintf(text, sizeof text, "%.*g", digits, x);
        for (p = text; *p == '-' || (*p >= '0' && *p <= '9'); ++p) {
        }
        if (*p && *p != 'e' && *p != 'n' && *p != 'i') { /* the locale's decimal separator */
            for (q = p; *q && !(*q >= '0' && *q <= '9'); ++q) {
            }
            *p++ = '.';
            memmove(p, q, (size_t)(text + n + 1 - q));
        }
        if (sfemi_text_real(text, text + strlen(text), &back) && !memcmp(&back, &x, sizeof x))
            break;
    }
    fputs(text, f);
    fputs(after, f);
}

static void sfemi_file_point(FILE *f, const sfem_real *x)
{
    sfemi_file_real(f, x[0], " ");
    sfemi_file_real(f, x[1], " ");
    sfemi_file_real(f, x[2], "\n");
}

SFEM_DEF sfem_status sfem_write_msh(const char *path, const sfem_mesh *mesh, sfem_error *err)
{
    const sfem_int *region;
    sfem_status status;
    sfem_int i, end, blocks = 0;
    FILE *f;
    SFEM_ASSERT(path && mesh);
    region = mesh->region;
    status = sfemi_file_create(path, &f, err);
    if (status != SFEM_OK) return status;
    fprintf(f, "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 %ld 1 %ld\n3 1 0 %ld\n",
            (long)mesh->nodes, (long)mesh->nodes, (long)mesh->nodes);
    for (i = 0; i < mesh->nodes; ++i) fprintf(f, "%ld\n", (long)i + 1);
    for (i = 0; i < mesh->nodes; ++i) sfemi_file_point(f, mesh->x + 3 * (size_t)i);
    for (i = 0; i < mesh->tets; ++i) blocks += i == 0 || (region && region[i] != region[i - 1]);
    fprintf(f, "$EndNodes\n$Elements\n%ld %ld 1 %ld\n", (long)blocks, (long)mesh->tets,
            (long)mesh->tets);
    for (i = 0; i < mesh->tets;) { /* a block for each run of tets of one region */
        for (end = i + 1; end < mesh->tets && (!region || region[end] == region[i]);) ++end;
        fprintf(f, "3 %ld 4 %ld\n", region ? (long)region[i] : 1L, (long)end - (long)i);
        for (; i < end; ++i) {
            const sfem_int *v = mesh->tet + 4 * (size_t)i;
            fprintf(f, "%ld %ld %ld %ld %ld\n", (long)i + 1, (long)v[0] + 1, (long)v[1] + 1,
                    (long)v[2] + 1, (long)v[3] + 1);
        }
    }
    fputs("$EndElements\n", f);
    return sfemi_file_close(f, path, err);
}

/* Text inside the quotes of an XML attribute. */
static void sfemi_file_xml(FILE *f, const char *text)
{
    for (; *text; ++text) {
        if (*text == '&')
            fputs("&amp;", f);
        else if (*text == '<')
            fputs("&lt;", f);
        else if (*text == '>')
            fputs("&gt;", f);
        else if (*text == '"')
            fputs("&quot;", f);
        else if ((unsigned char)*text < 32)
            fputc(' ', f);
        else
            fputc(*text, f);
    }
}

/* The header of an array in the appended data, whose place moves on by its size. */
static void sfemi_vtu_array(FILE *f, const char *type, const char *name, sfem_int components,
                            uint64_t bytes, uint64_t *offset)
{
    fprintf(f, "<DataArray type=\"%s\" Name=\"", type);
    sfemi_file_xml(f, name);
    fprintf(f, "\" NumberOfComponents=\"%ld\" format=\"appended\" offset=\"%lld\"/>\n",
            (long)components, (long long)*offset);
    *offset += bytes + 8;
}

static void sfemi_vtu_fields(FILE *f, const sfem_mesh *m, const sfem_field *fields, sfem_int count,
                             int per_tet, uint64_t *offset)
{
    const uint64_t items = (uint64_t)(per_tet ? m->tets : m->nodes);
    sfem_int i;
    fputs(per_tet ? "<CellData>\n" : "<PointData>\n", f);
    for (i = 0; i < count; ++i)
        if (!fields[i].per_tet == !per_tet)
            sfemi_vtu_array(f, "Float64", fields[i].name, fields[i].components,
                            items * (uint64_t)fields[i].components * sizeof(sfem_real), offset);
    if (per_tet && m->region) sfemi_vtu_array(f, "Int32", "region", 1, 4 * items, offset);
    fputs(per_tet ? "</CellData>\n" : "</PointData>\n", f);
}

static void sfemi_vtu_data(FILE *f, const void *data, uint64_t bytes)
{
    fwrite(&bytes, sizeof bytes, 1, f);
    if (bytes) fwrite(data, 1, (size_t)bytes, f);
}

/* The appended data, in the order of the headers. */
static void sfemi_vtu_append(FILE *f, const sfem_mesh *m, const sfem_real *x,
                             const sfem_field *fields, sfem_int count)
{
    const uint64_t nodes = (uint64_t)m->nodes, tets = (uint64_t)m->tets;
    uint64_t bytes = 8 * tets;
    sfem_int i;
    int per_tet;
    sfemi_vtu_data(f, x, nodes * 3 * sizeof *x);
    sfemi_vtu_data(f, m->tet, tets * 4 * sizeof *m->tet);
    fwrite(&bytes, sizeof bytes, 1, f);
    for (i = 1; i <= m->tets; ++i) {
        int64_t end = 4 * (int64_t)i;
        fwrite(&end, sizeof end, 1, f);
    }
    fwrite(&tets, sizeof tets, 1, f);
    for (i = 0; i < m->tets; ++i) fputc(10, f);
    for (per_tet = 0; per_tet < 2; ++per_tet)
        for (i = 0; i < count; ++i)
            if (!fields[i].per_tet == !per_tet)
                sfemi_vtu_data(f, fields[i].values,
                               (per_tet ? tets : nodes) * (uint64_t)fields[i].components *
                                   sizeof(sfem_real));
    if (m->region) sfemi_vtu_data(f, m->region, tets * sizeof *m->region);
}

SFEM_DEF sfem_status sfem_write_vtu(const char *path, const sfem_mesh *mesh, const sfem_real *x,
                                    const sfem_field *fields, sfem_int count, sfem_error *err)
{
    const uint16_t one = 1;
    unsigned char low;
    uint64_t offset = 0, nodes, tets;
    sfem_status status;
    sfem_int i;
    FILE *f;
    SFEM_ASSERT(path && mesh && (fields || count <= 0));
    for (i = 0; i < count; ++i)
        if (!fields[i].name || !fields[i].name[0] || !fields[i].values || fields[i].components < 1)
            return sfemi_fail(err, SFEM_BAD_ARGUMENT,
                              "field %ld needs a name, values and at least 1 component", (long)i);
    status = sfemi_file_create(path, &f, err);
    if (status != SFEM_OK) return status;
    memcpy(&low, &one, 1);
    nodes = (uint64_t)mesh->nodes;
    tets = (uint64_t)mesh->tets;
    fprintf(f,
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" "
            "byte_order=\"%s\" header_type=\"UInt64\">\n<UnstructuredGrid>\n"
            "<Piece NumberOfPoints=\"%ld\" NumberOfCells=\"%ld\">\n<Points>\n",
            low ? "LittleEndian" : "BigEndian", (long)mesh->nodes, (long)mesh->tets);
    sfemi_vtu_array(f, "Float64", "Points", 3, nodes * 3 * sizeof *mesh->x, &offset);
    fputs("</Points>\n<Cells>\n", f);
    sfemi_vtu_array(f, "Int32", "connectivity", 1, tets * 4 * sizeof *mesh->tet, &offset);
    sfemi_vtu_array(f, "Int64", "offsets", 1, 8 * tets, &offset);
    sfemi_vtu_array(f, "UInt8", "types", 1, tets, &offset);
    fputs("</Cells>\n", f);
    sfemi_vtu_fields(f, mesh, fields, count, 0, &offset);
    sfemi_vtu_fields(f, mesh, fields, count, 1, &offset);
    fputs("</Piece>\n</UnstructuredGrid>\n<AppendedData encoding=\"raw\">\n_", f);
    sfemi_vtu_append(f, mesh, x ? x : mesh->x, fields, count);
    fputs("\n</AppendedData>\n</VTKFile>\n", f);
    return sfemi_file_close(f, path, err);
}

SFEM_DEF sfem_status sfem_write_pvd(const char *path, const char *const *files,
                                    const sfem_real *times, sfem_int count, sfem_error *err)
{
    sfem_status status;
    sfem_int i;
    FILE *f;
    SFEM_ASSERT(path && ((files && times) || count <= 0));
    for (i = 0; i < count; ++i)
        if (!files[i] || !sfemi_finite(times[i]))
            return sfemi_fail(err, SFEM_BAD_ARGUMENT, "file %ld needs a name and a finite time",
                              (long)i);
    status = sfemi_file_create(path, &f, err);
    if (status != SFEM_OK) return status;
    fputs("<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\">\n<Collection>\n",
          f);
    for (i = 0; i < count; ++i) {
        fputs("<DataSet timestep=\"", f);
        sfemi_file_real(f, times[i], "\" part=\"0\" file=\"");
        sfemi_file_xml(f, files[i]);
        fputs("\"/>\n", f);
    }
    fputs("</Collection>\n</VTKFile>\n", f);
    return sfemi_file_close(f, path, err);
}

SFEM_DEF sfem_status sfem_write_obj(const char *path, const sfem_mesh *mesh,
                                    const sfem_surface *surface, const sfem_real *x,
                                    sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfem_surface own;
    sfem_int *number = NULL, i, n = 0;
    size_t k;
    FILE *f = NULL;
    SFEM_ASSERT(path && mesh);
    memset(&own, 0, sizeof own);
    if (!surface) {
        SFEMI_TRY(sfem_mesh_surface(mesh, &mesh->allocator, &own, err));
        surface = &own;
    }
    if (!x) x = mesh->x;
    SFEMI_NEW(sfem_int, number, &mesh->allocator, mesh->nodes);
    for (k = 0; k < 3 * (size_t)surface->triangles; ++k) number[surface->tri[k]] = 1;
    SFEMI_TRY(sfemi_file_create(path, &f, err));
    for (i = 0; i < mesh->nodes; ++i)
        if (number[i]) {
            number[i] = ++n;
            fputs("v ", f);
            sfemi_file_point(f, x + 3 * (size_t)i);
        }
    for (k = 0; k < 3 * (size_t)surface->triangles; k += 3)
        fprintf(f, "f %ld %ld %ld\n", (long)number[surface->tri[k]],
                (long)number[surface->tri[k + 1]], (long)number[surface->tri[k + 2]]);
    status = sfemi_file_close(f, path, err);
done:
    sfemi_delete(&mesh->allocator, number);
    sfem_surface_free(&own);
    return status;
}

#endif /* SFEM_NO_STDIO */

/* ============================================================================================
 * >>sparse   3x3-block matrices, ordering, LDL^T, dense, conjugate gradients
 * ============================================================================================ */

/* ============================================================================================
 * >>element   linear tetrahedron
 * ============================================================================================ */

/* ============================================================================================
 * >>fem   assembly, mass, damping, loads, stress
 * ============================================================================================ */

/* ============================================================================================
 * >>factor   the shared factor of a body's system matrix
 * ============================================================================================ */

/* ============================================================================================
 * >>handle   pins and handles set, moved and released while the body runs
 * ============================================================================================ */

/* ============================================================================================
 * >>newmark   implicit Newmark
 * ============================================================================================ */

/* ============================================================================================
 * >>pqr   the (p,q,r) family, central difference
 * ============================================================================================ */

/* ============================================================================================
 * >>body   the pipeline that a user calls: create, prepare, step, read
 * ============================================================================================ */

#ifdef __cplusplus
}
#endif
#endif /* SOFTFEM_IMPLEMENTATION */

/* ============================================================================================
 * CHANGES
 *   0.1.0   meshes, linear bodies, Newmark, (p,q,r), central difference, handles
 *
 * LICENCE, at your choice
 *
 * A. MIT License. Copyright (c) 2026 the softfem.h authors
 * Permission is hereby granted, free of charge, to any person obtaining a copy of this software and
 * associated documentation files (the "Software"), to deal in the Software without restriction,
 * including without limitation the rights to use, copy, modify, merge, publish, distribute,
 * sublicense, and/or sell copies of the Software, and to permit persons to whom the Software is
 * furnished to do so, subject to the following conditions: The above copyright notice and this
 * permission notice shall be included in all copies or substantial portions of the Software.
 * THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT
 * NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND
 * NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM,
 * DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM, OUT
 * OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
 *
 * B. Public Domain (www.unlicense.org). This is free and unencumbered software released into the
 * public domain. Anyone is free to copy, modify, publish, use, compile, sell, or distribute this
 * software, either in source code form or as a compiled binary, for any purpose, commercial or
 * non-commercial, and by any means. In jurisdictions that recognize copyright laws, the author or
 * authors of this software dedicate any and all copyright interest in the software to the public
 * domain. We make this dedication for the benefit of the public at large and to the detriment of our
 * heirs and successors. We intend this dedication to be an overt act of relinquishment in perpetuity
 * of all present and future rights to this software under copyright law. THE SOFTWARE IS PROVIDED "AS
 * IS", WITHOUT WARRANTY OF ANY KIND.
 * ============================================================================================ */
