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
 * A whole program is examples/hello.c.
 *
 * CONTENTS (search for the marker)
 *
 *     API    >>api-base     status, errors, memory, threads       >>api-mesh    >>api-meshio
 *            >>api-matrix   sparse and dense matrices, solvers    >>api-element >>api-model
 *            >>api-damage   fracture on the edge graph            >>api-body
 *            >>api-modes    eigenvalues and modes                 >>api-reduced modal bodies, warping
 *            >>api-link     modal motion over a lossy link
 *     IMPL   >>base         status, allocation, threads, vector paths
 *            >>math         3-vectors, 3x3 matrices, polar and singular value decomposition
 *            >>mesh         tets, surface, generators, checks, renumbering
 *            >>meshio       readers and writers
 *            >>sparse       3x3-block matrices, ordering, LDL^T, dense, conjugate gradients
 *            >>element      linear, corotational, StVK, neo-Hookean tetrahedron; edge lengths
 *            >>fem          assembly, mass, damping, forces, tangents, loads, stress
 *            >>damage       edge form of the tet, damage laws, criterion, pieces
 *            >>factor       the shared factor of a body's system matrix
 *            >>state        what of a body changes, in one block of memory
 *            >>handle       pins and handles set, moved and released while the body runs
 *            >>newmark      linear Newmark
 *            >>implicit     Newton: nonlinear Newmark, backward Euler, HHT, generalized-alpha, Bathe;
 *                           nonlinear statics
 *            >>pqr          the (p,q,r) family, central difference
 *            >>turn         A^-1 in a body that turns: frames, rigid projection
 *            >>guard        (p,q,r) for nonlinear laws: energies watched, steps done again
 *            >>body         the pipeline that a user calls: create, prepare, step, read
 *            >>modes        block Lanczos, proof by inertia
 *            >>reduced      modal bodies: oscillators, warping, handles
 *            >>link         packets of accelerations, key frames
 *            >>kernels      inner loops, compiled once for each vector path
 *     TAIL   licence, changes
 *
 * UNITS are the caller's, as long as they are consistent; the comments say SI (m, kg, s, N, Pa).
 *
 * SWITCHES, all to be defined the same way in every file that includes the header
 *
 *     SFEM_STATIC        every function static: the whole library inside one source file
 *     SFEM_ASSERT(x)     what to do about misuse of the interface; default assert(x)
 *     SFEM_NO_STDIO      leave out what takes a file path; sfem_mesh_parse stays
 *     SFEM_NO_DISPATCH   portable kernels only, whatever the processor offers
 *     SFEM_FORCE_PATH    0 portable, 1 AVX2, 2 AVX-512: that one, whatever the processor offers
 *     SFEM_SELF          the name by which this file can include itself; default "softfem.h"
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
#if !defined(__clang__) && !defined(SOFTFEM_IMPLEMENTATION)
#pragma GCC diagnostic ignored "-Wunused-function" /* gcc: declared static but never defined */
#endif
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
    const sfem_int *row;                    /* [n+1] */
    const sfem_int *col;                    /* [row[n]] */
    sfem_real *val;                         /* [row[n]][3][3], row-major blocks */
    const struct sfem_matrix_upper *upper;  /* where the columns are, or NULL: see below */
} sfem_matrix;

/* The upper half of a pattern, seen by rows: the blocks k in (start[j], start[j+1]) of row i = row[.]
 * stand in column j < i and are val[entry[.]]. Only a product on several threads needs it. */
typedef struct sfem_matrix_upper {
    sfem_int n;
    sfem_int *start; /* [n+1] */
    sfem_int *row;   /* [start[n]], ascending for each column */
    sfem_int *entry; /* [start[n]] */
    sfem_allocator allocator;
} sfem_matrix_upper;

/* A matrix that owns its arrays, the sum of count blocks: block[e] is added at (i[e], j[e]), and
 * transposed at (j[e], i[e]) where that is the lower half. The diagonal blocks need not be named.
 * block may be NULL: then the pattern is made and the values are 0. Duplicates are added in the order
 * in which they are given.
 *   errors  SFEM_BAD_ARGUMENT (an index outside [0, n)), SFEM_TOO_LARGE, SFEM_OUT_OF_MEMORY
 *   cost    O(n + count) */
SFEM_DEF sfem_status sfem_matrix_create(sfem_int n, sfem_int count, const sfem_int *i,
                                        const sfem_int *j, const sfem_real *block /* [count][3][3] */,
                                        const sfem_allocator *allocator, sfem_matrix *out,
                                        sfem_error *err);
SFEM_DEF void sfem_matrix_free(sfem_matrix *a, const sfem_allocator *allocator); /* not a->upper */

/* Is it what the struct says, and every number finite? SFEM_BAD_ARGUMENT or SFEM_NOT_FINITE with the
 * node (block row). */
SFEM_DEF sfem_status sfem_matrix_check(const sfem_matrix *a, sfem_error *err);

SFEM_DEF sfem_status sfem_matrix_upper_create(const sfem_matrix *a, const sfem_allocator *allocator,
                                              sfem_matrix_upper *out, sfem_error *err);
SFEM_DEF void sfem_matrix_upper_free(sfem_matrix_upper *upper);

/* y = A x, [3n]. On several threads if a->upper is set (each row is then gathered, lower half first),
 * and else on one: the same bits for any number of threads. x and y must not overlap. */
SFEM_DEF void sfem_matrix_multiply(const sfem_matrix *a, const sfem_real *x, sfem_real *y,
                                   const sfem_exec *exec);

/* Both halves as scalars, for other libraries: count first, then fill. */
SFEM_DEF size_t sfem_matrix_csr_count(const sfem_matrix *a); /* entries, all blocks counted whole */
SFEM_DEF sfem_status sfem_matrix_to_csr(const sfem_matrix *a, sfem_int *row /* [3n+1] */,
                                        sfem_int *col, sfem_real *val /* [count] each */,
                                        sfem_error *err);
SFEM_DEF void sfem_matrix_to_dense(const sfem_matrix *a, sfem_real *full /* [3n][3n] */);

/* --- L D L^T of a sparse matrix --------------------------------------------------------------
 *
 * Multifrontal [Duff and Reid 1983] on 3x3 blocks, without pivoting: A = P^T L S L^T P, L lower
 * triangular with a positive diagonal, S the signs of the pivots, so that L |d|^1/2 of the textbook's
 * L D L^T is what is stored. Positive definite matrices are always safe; of an indefinite one (K -
 * sigma M) the number of negative pivots is its number of negative eigenvalues [Sylvester], and it is
 * refused where a pivot drowns in rounding or a trial solve fails: that number would be a guess. */

typedef enum sfem_ordering {
    SFEM_ORDER_BEST,       /* of the following two, what needs fewer operations */
    SFEM_ORDER_AMD,        /* approximate minimum degree of the node graph */
    SFEM_ORDER_DISSECTION, /* nested dissection by planes; needs coordinates */
    SFEM_ORDER_NATURAL     /* as the rows stand */
} sfem_ordering;

typedef struct sfem_ldl sfem_ldl; /* immutable once made, but for sfem_ldl_refactor */

typedef struct sfem_ldl_def {
    sfem_ordering ordering;
    const sfem_real *x; /* [n][3] coordinates of the nodes, only read while creating, or NULL */
    int positive;       /* every pivot must be > 0, else SFEM_NOT_SPD */
    int mixed;          /* keep a float copy of L, which the solves use: half the memory traffic */
    int keep;           /* keep the update matrices, so that a part can be refactored */
    sfem_allocator allocator;
    sfem_exec exec; /* used by create and refactor */
} sfem_ldl_def;

typedef struct sfem_ldl_info {
    sfem_int n, supernodes;
    sfem_ordering ordering; /* the one that was taken */
    size_t nnz;             /* scalars in L with its diagonal, zeros of merged columns included */
    double flops;           /* operations that the ordering needs, without those on such zeros */
    size_t bytes;           /* all of it: factor_bytes + analysis_bytes + work_bytes */
    size_t factor_bytes;    /* L, and its float copy */
    size_t analysis_bytes;  /* shared with those made by sfem_ldl_create_like */
    size_t work_bytes;      /* update matrices */
    sfem_int negative;      /* pivots < 0 */
    sfem_real pivot_min, pivot_max; /* of their absolute values */
    sfem_real residual;     /* unless def.positive: |b - A x| / (|A| |x| + |b|) of a trial solve */
    const char *path;       /* the vector path: "portable", "avx2", "avx512" */
} sfem_ldl_info;

SFEM_DEF sfem_ldl_def sfem_default_ldl_def(void); /* BEST, positive = 1, the rest 0 */

/* Analyses the pattern and factorises A.
 *   errors  SFEM_NOT_SPD (positive = 1: node and pivot), SFEM_SINGULAR (positive = 0: node),
 *           SFEM_NOT_FINITE (node), SFEM_BAD_ARGUMENT (the pattern is not what sfem_matrix promises,
 *           or dissection without coordinates), SFEM_TOO_LARGE, SFEM_OUT_OF_MEMORY
 *   n = 0   is allowed */
SFEM_DEF sfem_status sfem_ldl_create(const sfem_ldl_def *def, const sfem_matrix *a, sfem_ldl **out,
                                     sfem_error *err);

/* The same for another matrix of the same pattern; the analysis is shared (counted atomically), the
 * options are those of `like`. SFEM_MISMATCH if n or the number of blocks differ; the rest of the
 * pattern is the caller's word. */
SFEM_DEF sfem_status sfem_ldl_create_like(const sfem_ldl *like, const sfem_matrix *a, sfem_ldl **out,
                                          sfem_error *err);

/* New values on the same pattern; allocates nothing. After a failure the factor is void (there is no
 * room for two) and may only be refactored again or freed. */
SFEM_DEF sfem_status sfem_ldl_refactor(sfem_ldl *ldl, const sfem_matrix *a, sfem_error *err);

/* The same where only blocks (i, j) have changed with both i and j among the given nodes: renews the
 * path from them to the root of the elimination tree, with the very bits of a full refactorisation.
 * Needs def.keep, else does a full one. */
SFEM_DEF sfem_status sfem_ldl_refactor_nodes(sfem_ldl *ldl, const sfem_matrix *a, sfem_int count,
                                             const sfem_int *node, sfem_error *err);

/* Solves A x = b in place for rhs right sides. Const: many threads may solve with one factor, each
 * with its own work array. exec may be NULL. Allocates nothing; the bits do not depend on exec, but
 * may differ between a right side alone and among others. */
SFEM_DEF size_t sfem_ldl_work_size(const sfem_ldl *ldl, sfem_int rhs); /* in sfem_real */
SFEM_DEF void sfem_ldl_solve(const sfem_ldl *ldl, sfem_int rhs, sfem_real *x /* [rhs][3n] */,
                             sfem_real *work, const sfem_exec *exec);

SFEM_DEF sfem_ldl_info sfem_ldl_get_info(const sfem_ldl *ldl);
SFEM_DEF void sfem_ldl_free(sfem_ldl *ldl); /* NULL is allowed */

/* --- dense matrices: lower half, column-major, a[i + j n], in place ---------------------------
 *
 * For matrices that are full. Of a mesh's they beat the sparse factor only below 35 scalars, or 70 if
 * its analysis counts too (measured); O(n^3 / 3), O(n^2) for a solve. */

/* A = L L^T. SFEM_NOT_SPD names in err->node the row / 3; a is then partly overwritten. */
SFEM_DEF sfem_status sfem_dense_cholesky(sfem_int n, sfem_real *a, sfem_error *err);
/* A = L D L^T without pivoting, D on the diagonal; the number of negative pivots. SFEM_SINGULAR if a
 * pivot is below 1e-14 of its row. */
SFEM_DEF sfem_status sfem_dense_ldl(sfem_int n, sfem_real *a, sfem_int *negative, sfem_error *err);
SFEM_DEF void sfem_dense_cholesky_solve(sfem_int n, const sfem_real *a, sfem_int rhs,
                                        sfem_real *x /* [rhs][n] */);
SFEM_DEF void sfem_dense_ldl_solve(sfem_int n, const sfem_real *a, sfem_int rhs,
                                   sfem_real *x /* [rhs][n] */);

/* A x = lambda B x, all of it: B (NULL: the identity) symmetric positive definite, both lower halves.
 * lambda [n] ascends; vector k is written over A, at a + k n, with x_i.B x_j = delta_ij, and B is
 * overwritten with its Cholesky factor. Householder's reduction to a tridiagonal matrix, then implicit
 * QL [Bowdler, Martin, Reinsch, Wilkinson 1968]: errors of a few rounding errors of the largest
 * |lambda|, whatever the others. About 9 n^3 operations, with B 11 n^3.
 *   work    [5 n] reals
 *   errors  SFEM_NOT_SPD (B; err->node is the row / 3), SFEM_NOT_FINITE, SFEM_NOT_CONVERGED (never
 *           seen); A and B are then void */
SFEM_DEF sfem_status sfem_dense_eigen(sfem_int n, sfem_real *a, sfem_real *b, sfem_real *lambda,
                                      sfem_real *work, sfem_error *err);

/* --- conjugate gradients [Hestenes and Stiefel 1952] ------------------------------------------ */

typedef struct sfem_cg_def {
    sfem_real tolerance;            /* stop at |b - A x| <= tolerance |b|; 1e-8 */
    sfem_int max_iterations;        /* 0: 3n */
    const sfem_ldl *preconditioner; /* NULL: the inverse diagonal blocks */
    sfem_exec exec;
} sfem_cg_def;

typedef struct sfem_cg_info {
    sfem_int iterations;
    sfem_real residual; /* |b - A x| / |b|, computed anew at the end */
    int converged;
} sfem_cg_info;

SFEM_DEF sfem_cg_def sfem_default_cg_def(void);
SFEM_DEF size_t sfem_cg_work_size(const sfem_cg_def *def, const sfem_matrix *a); /* in sfem_real */

/* Solves A x = b from the x given; allocates nothing. info is written unless the status is one of the
 * first three, and may be NULL.
 *   errors  SFEM_NOT_SPD (a direction of negative curvature, or a diagonal block: node),
 *           SFEM_NOT_FINITE, SFEM_MISMATCH (the preconditioner's size),
 *           SFEM_NOT_CONVERGED: x is the last iterate, and may do */
SFEM_DEF sfem_status sfem_cg_solve(const sfem_cg_def *def, const sfem_matrix *a, const sfem_real *b,
                                   sfem_real *x, sfem_real *work, sfem_cg_info *info,
                                   sfem_error *err);

/* ============================================================================================
 * >>api-element   materials: energy, stress, tangent; energies in edge lengths
 * ============================================================================================ */

/* Materials, by their energy density Psi(F), Pa, of the deformation gradient F = dx/dX. lambda
 * and mu are Lame's parameters; all agree for small strains and are zero, and least, at rest.
 *   SFEM_LINEAR         lambda/2 tr(e)^2 + mu e:e, e = (F + F^T)/2 - I. Small rotations only.
 *   SFEM_COROTATIONAL   lambda/2 tr(S - I)^2 + mu |F - R|^2, F = R S, R the nearest proper
 *                       rotation [Mueller, Gross 2004; the energy: McAdams et al. 2011]. Small
 *                       strains; any rotation; inverted tets recover.
 *   SFEM_STVK           lambda/2 tr(E)^2 + mu E:E, E = (F^T F - I)/2, St. Venant-Kirchhoff.
 *                       Weak in compression: below .58 of its length the force on a bar falls
 *                       (at nu = 0) and is zero at length 0; it does not feel a mirror image,
 *                       so inverted tets stay inverted. For large rotations and stretches, not
 *                       for crushing.
 *   SFEM_NEOHOOKEAN     m/2 (I_C - 3) - m/2 log((I_C + 1)/4) + l/2 (J - 1)^2 - 3/4 m (J - 1), m
 *                       = 4/3 mu, l = lambda + 5/6 mu, I_C = tr(F^T F), J = det F: the stable
 *                       neo-Hookean of Smith, de Goes, Kim 2018. Any strain, defined through
 *                       inversion; keeps volume best as nu nears 0.5. */
typedef enum sfem_law { SFEM_LINEAR, SFEM_COROTATIONAL, SFEM_STVK, SFEM_NEOHOOKEAN } sfem_law;

/* Derivatives of the stress.
 *   SFEM_TANGENT_EXACT   dP/dF as it is, indefinite where the material buckles.
 *                        SFEM_COROTATIONAL has a pole where the two smallest signed singular
 *                        values of F sum to 0: there the sum is kept above 1e-8.
 *   SFEM_TANGENT_PSD     its negative eigenvalues set to 0: the nearest positive semidefinite
 *                        one, from closed forms in singular values [Smith, de Goes, Kim 2019]
 *   SFEM_TANGENT_FROZEN  SFEM_COROTATIONAL without the change of R: R k R^T, always positive
 *                        semidefinite; the other laws as with SFEM_TANGENT_PSD */
typedef enum sfem_tangent {
    SFEM_TANGENT_EXACT,
    SFEM_TANGENT_PSD,
    SFEM_TANGENT_FROZEN
} sfem_tangent;

/* Where forces are computed. SFEM_MIXED keeps a factor, or the arithmetic inside a tet, in
 * float and everything else in double: half the memory traffic, a residual of a solve of about
 * 4e-7 on good meshes, forces to about 1e-7 of the modulus, which is 1e-4 of the force at a
 * strain of 1e-3. */
typedef enum sfem_precision { SFEM_DOUBLE, SFEM_MIXED } sfem_precision;

/* Lame's parameters, Pa, of Young's modulus (Pa, > 0) and Poisson's ratio, in (-1, 0.5). */
SFEM_DEF void sfem_law_lame(sfem_real young, sfem_real poisson, sfem_real *lambda, sfem_real *mu);

/* Psi, Pa. Matrices are row-major 3x3 everywhere: F[3*i+j] = dx_i/dX_j. Any F will do, flat,
 * inverted or zero; a number that is not finite gives numbers that are not finite. Tens of ns,
 * 0.7 us where R is all but undetermined. */
SFEM_DEF sfem_real sfem_law_energy(sfem_law law, sfem_real lambda, sfem_real mu,
                                   const sfem_real f[9]);

/* P = dPsi/dF, the first Piola-Kirchhoff stress, Pa; returns Psi. */
SFEM_DEF sfem_real sfem_law_stress(sfem_law law, sfem_real lambda, sfem_real mu,
                                   const sfem_real f[9], sfem_real p[9]);

/* tangent[9*a+b] = dP_a/dF_b, symmetric; and its product with one dF: dP. */
SFEM_DEF void sfem_law_tangent(sfem_law law, sfem_real lambda, sfem_real mu, const sfem_real f[9],
                               sfem_tangent kind, sfem_real tangent[81]);
SFEM_DEF void sfem_law_differential(sfem_law law, sfem_real lambda, sfem_real mu,
                                    const sfem_real f[9], sfem_tangent kind, const sfem_real df[9],
                                    sfem_real dp[9]);

/* The tet of nodes x [4][3] (rest, m, right-handed, not flat) displaced by u [4][3]: its
 * energy, J, the gradient of it, force [4][3], N, and the gradient of that, k [12][12], N/m.
 * force and k may be NULL. */
SFEM_DEF sfem_real sfem_law_tet(sfem_law law, sfem_real lambda, sfem_real mu, const sfem_real x[12],
                                const sfem_real u[12], sfem_tangent kind, sfem_real force[12],
                                sfem_real k[144]);

/* Vector width of the kernels that run on this processor, in doubles: 8 (AVX-512), 4 (AVX2), or
 * 1, which stands for whatever the compiler makes of the portable ones. */
SFEM_DEF int sfem_vector_width(void);

/* F = R S: R the proper rotation nearest to F, S symmetric (NULL: not wanted). With negative
 * det F the smallest eigenvalue of S is negative. Where R is not unique (F of rank 1, or a
 * double smallest singular value of an inverted F) one of the nearest is given, I for F = 0.
 * Never fails on finite F; R is orthogonal and S symmetric to a few rounding errors (of |F|). */
SFEM_DEF void sfem_polar(const sfem_real f[9], sfem_real r[9], sfem_real s[9]);

/* F = U diag(s) V^T, U and V proper rotations, s[0] >= s[1] >= |s[2]|, s[2] with the sign of
 * det F: one-sided Jacobi, small singular values to their own rounding error. Entries below
 * 1e-150 of the largest count as 0. */
SFEM_DEF void sfem_signed_svd(const sfem_real f[9], sfem_real u[9], sfem_real s[3], sfem_real v[9]);

/* ENERGIES IN EDGE LENGTHS. The right Cauchy-Green tensor C = F^T F follows from the squared
 * lengths alone: (d_k/L_k)^2 = n_k.C n_k for each edge k with rest length L_k and rest
 * direction n_k, and with it all invariants and every isotropic energy [Mandal, Chaudhuri,
 * Chaudhuri 2023, supplement, Theorem 2.1 and eqs. 1-9]. dim = 3: tets, six edges 01 02 03 12
 * 13 23; dim = 2: triangles in their plane, three edges 01 02 12, in plane strain. Flat tets
 * and triangles have the C of least norm that fits best. */
typedef struct sfem_edge_shape {
    int dim, nodes, edges;
    int rank;          /* edges, or less where flat */
    sfem_real volume;  /* m^3, or m^2 for a triangle; 0 where flat */
    sfem_real c[6][9]; /* dC/d(d_k^2), 1/m^2: dim x dim, row-major */
} sfem_edge_shape;

/* x [nodes][dim]: rest positions, m, of any sense. */
SFEM_DEF void sfem_edge_prepare(int dim, const sfem_real *x, sfem_edge_shape *out);
/* d2 [edges]: squared lengths, m^2, of positions x [nodes][dim]. */
SFEM_DEF void sfem_edge_lengths2(int dim, const sfem_real *x, sfem_real *d2);
/* C [dim][dim] of squared lengths. */
SFEM_DEF void sfem_edge_cauchy_green(const sfem_edge_shape *shape, const sfem_real *d2,
                                     sfem_real *c);
/* I_C = tr C, II_C = tr C^2, III_C = det C, and with a fibre a [dim] (NULL: 0) IV_C = a.C a,
 * V_C = a.C^2 a. */
SFEM_DEF void sfem_edge_invariants(const sfem_edge_shape *shape, const sfem_real *d2,
                                   const sfem_real *fibre, sfem_real invariants[5]);
/* Psi, Pa, of SFEM_STVK or SFEM_NEOHOOKEAN, and slope [edges] = dPsi/d(d_k^2), Pa/m^2, or NULL.
 * Lengths do not tell a tet from its mirror image: J = sqrt(III_C), in the slope kept above
 * 1e-8. */
SFEM_DEF sfem_real sfem_edge_energy(const sfem_edge_shape *shape, sfem_law law, sfem_real lambda,
                                    sfem_real mu, const sfem_real *d2, sfem_real *slope);
/* The gradient of volume Psi at positions x [nodes][dim]: force_i = 2 V sum_j slope_ij (x_i -
 * x_j), N. The force on node i is its negative. */
SFEM_DEF void sfem_edge_forces(const sfem_edge_shape *shape, const sfem_real *x,
                               const sfem_real *slope, sfem_real *force);

/* ============================================================================================
 * >>api-model   finite elements: K, M, D, loads, stress
 * ============================================================================================ */

typedef enum sfem_mass { SFEM_MASS_LUMPED, SFEM_MASS_CONSISTENT } sfem_mass;

/* An isotropic material. The damping matrix of a tet is alpha M_e + beta K_e (Rayleigh). */
typedef struct sfem_material {
    sfem_real young;   /* Young's modulus, Pa, > 0 */
    sfem_real poisson; /* Poisson's ratio, -1 < nu < 0.5; linear tets lock as nu nears 0.5 */
    sfem_real density; /* kg/m^3, > 0 */
    sfem_real alpha;   /* mass damping, 1/s, >= 0 */
    sfem_real beta;    /* stiffness damping, s, >= 0 */
    sfem_law law;      /* >>api-element; K, M, D are the same for all */
} sfem_material;

SFEM_DEF sfem_material sfem_default_material(void); /* 1e6 Pa, 0.3, 1000 kg/m^3, undamped, linear */

/* What never changes while bodies move: mesh, materials, K, M, D. Shared by any number of bodies and
 * threads; reference-counted, each body holds one. */
typedef struct sfem_model sfem_model;

typedef struct sfem_model_def {
    const sfem_mesh *mesh;          /* copied */
    sfem_material material;         /* of every tet, where materials is NULL */
    const sfem_material *materials; /* [material_count] or NULL */
    sfem_int material_count;
    const sfem_int *tet_material; /* [tets] index into materials; NULL: mesh->region is the index */
    sfem_mass mass;               /* lumped: rho V/4 a node; consistent: rho V/20 (1 + delta_ab) */
    const sfem_matrix *damping;   /* added to D, N s/m: any matrix within K's pattern, or NULL */
    sfem_allocator allocator;
} sfem_model_def;

SFEM_DEF sfem_model_def sfem_default_model_def(void);

/* Builds a model of linear tetrahedra, K_e = V B^T C B.
 *   errors  SFEM_BAD_MESH (empty, index out of range, flat or left-handed tet), SFEM_NOT_FINITE,
 *           SFEM_BAD_ARGUMENT (material, region, damping pattern), SFEM_OUT_OF_MEMORY,
 *           SFEM_TOO_LARGE; the text names the tet or node. A node in no tet has no mass and
 *           stays where it is.
 *   cost    O(tets), about 0.7 us a tet */
SFEM_DEF sfem_status sfem_model_create(const sfem_model_def *def, sfem_model **out, sfem_error *err);
SFEM_DEF void sfem_model_free(sfem_model *model); /* NULL allowed; memory goes with the last body */

SFEM_DEF const sfem_mesh *sfem_model_mesh(const sfem_model *model);
SFEM_DEF const sfem_matrix *sfem_model_stiffness(const sfem_model *model); /* K, N/m */
SFEM_DEF const sfem_real *sfem_model_node_mass(const sfem_model *model);   /* [nodes] row sums of M, kg */
SFEM_DEF const sfem_real *sfem_model_tet_volume(const sfem_model *model);  /* [tets] m^3 */
SFEM_DEF sfem_real sfem_model_total_mass(const sfem_model *model);         /* kg */

/* out = k K + m M + d D as a matrix of its own, on K's pattern, to be freed with sfem_matrix_free:
 * (0,1,0) is M, (0,0,1) is D, (p h^2, r, q h/2) the matrix that (p,q,r) factors. */
SFEM_DEF sfem_status sfem_model_combine(const sfem_model *model, sfem_real k, sfem_real m, sfem_real d,
                                        const sfem_allocator *allocator, sfem_matrix *out,
                                        sfem_error *err);

/* y = K x, M x or D x; arrays [nodes][3], y must not be x. */
SFEM_DEF void sfem_model_multiply_stiffness(const sfem_model *model, const sfem_real *x, sfem_real *y,
                                            const sfem_exec *exec);
SFEM_DEF void sfem_model_multiply_mass(const sfem_model *model, const sfem_real *x, sfem_real *y,
                                       const sfem_exec *exec);
SFEM_DEF void sfem_model_multiply_damping(const sfem_model *model, const sfem_real *x, sfem_real *y,
                                          const sfem_exec *exec);

/* The elastic energy at displacements u [nodes][3], J, by every tet's own law, and its gradient,
 * the internal force [nodes][3], N (what the body pushes back with is its negative). A
 * translation changes nothing but the rounding of u; the forces of a tet sum to zero.
 *   rotation  [tets][3][3] nearest rotation of each F, I for linear tets; or NULL
 *   inverted  how many tets have det F <= 0; or NULL
 *   work      [sfem_model_work_size] reals
 *   cost      a tet, with AVX2: linear 12 ns, StVK 15, neo-Hookean 20, corotational 24, mixed 19;
 *             0.7 us for one whose R is all but undetermined. Any finite u will do; others give
 *             an energy that is not finite.
 * Allocates nothing. Same bits for any number of threads, but not from one vector width (see
 * sfem_vector_width) to another. */
SFEM_DEF size_t sfem_model_work_size(const sfem_model *model);
SFEM_DEF sfem_real sfem_model_forces(const sfem_model *model, const sfem_real *u,
                                     sfem_precision precision, sfem_real *force,
                                     sfem_real *rotation, sfem_int *inverted, sfem_real *work,
                                     const sfem_exec *exec);

/* tangent = the derivative of that force, N/m: overwrites the values of a matrix on K's pattern,
 * such as sfem_model_combine makes. 0.2 (linear) to 0.8 us a tet; allocates nothing; same bits for
 * any number of threads. */
SFEM_DEF void sfem_model_tangent(const sfem_model *model, const sfem_real *u, sfem_tangent kind,
                                 sfem_matrix *tangent, const sfem_exec *exec);

/* Cauchy stress of the displacement u [nodes][3] under small strain, constant in a tet:
 * stress [tets][6] in the order xx yy zz xy xz yz, von_mises [tets], Pa; either may be NULL. */
SFEM_DEF void sfem_model_stress(const sfem_model *model, const sfem_real *u, sfem_real *stress,
                                sfem_real *von_mises);
/* 1/2 u.K u, J, summed from the tets' own strains. */
SFEM_DEF sfem_real sfem_model_elastic_energy(const sfem_model *model, const sfem_real *u);

/* Loads, added to force [nodes][3], N: gravity g (m/s^2) on a model; a traction t (Pa, dead) or a
 * pressure p (Pa, against the outward normal) on surface triangles tri [count][3], at positions
 * x [nodes][3] or, where x is NULL, at rest. */
SFEM_DEF void sfem_add_gravity(const sfem_model *model, const sfem_real g[3], sfem_real *force);
SFEM_DEF void sfem_add_traction(const sfem_mesh *mesh, const sfem_real *x, sfem_int count,
                                const sfem_int *tri, const sfem_real t[3], sfem_real *force);
SFEM_DEF void sfem_add_pressure(const sfem_mesh *mesh, const sfem_real *x, sfem_int count,
                                const sfem_int *tri, sfem_real p, sfem_real *force);

/* ============================================================================================
 * >>api-damage   fracture on the edge graph
 * ============================================================================================ */

/* ============================================================================================
 * >>api-body   a body that moves
 * ============================================================================================ */

/* M u'' + D u' + K u = F. All three are of the family  A a = rhs, A = r M + (q/2) h D + p h^2 K, and
 * share factors:
 *   SFEM_PQR      one solve with a constant A:  A a = F - f(u) - D w,  w' = w + h a,  u' = u + h w'
 *                 [Yuan et al. 2017, "A novel unconditionally stable explicit integration method for
 *                 finite element method"]. (p,1,1) is Newmark(beta = p, gamma = 1/2).
 *   SFEM_NEWMARK  Newmark(beta, gamma) in accelerations [Newmark 1959]
 *   SFEM_CENTRAL  central difference, p = 0; refused beyond its stable step
 * The implicit methods solve M a + D(v) + f(u) = F at or within the end of the step by Newton's iteration
 * (see sfem_newton_def), once and with one constant factor where the body is linear. All are
 * unconditionally stable for linear bodies, and second order but for the first:
 *   SFEM_BACKWARD_EULER      first order, damps everything
 *   SFEM_HHT                 [Hilber, Hughes, Taylor 1977], hht_alpha = .1 damps a little at high Omega
 *   SFEM_GENERALIZED_ALPHA   [Chung and Hulbert 1993], by rho_inf, the spectral radius at Omega = infinity
 *   SFEM_BATHE               [Bathe and Baig 2005]: half a step of the trapezoidal rule, then three-point
 *                            backward differences; two systems a step
 *   SFEM_NEWMARK             is one of them where the model or its damping is nonlinear [Yuan et al. 2017,
 *                            algorithm 1] */
typedef enum sfem_integrator {
    SFEM_PQR,
    SFEM_NEWMARK,
    SFEM_CENTRAL,
    SFEM_BACKWARD_EULER,
    SFEM_HHT,
    SFEM_GENERALIZED_ALPHA,
    SFEM_BATHE
} sfem_integrator;

/* How (p,q,r) starts from u0, v0. Newmark's own first step (default), or for p = 1/12 without
 * damping a start of fourth order. */
typedef enum sfem_start { SFEM_START_NEWMARK, SFEM_START_FOURTH_ORDER } sfem_start;

#define SFEM_P_AUTO (-1.0) /* linear body: 1/12 where every mode is resolved (omega_max h < 2) */
#define SFEM_P_SAFE (-2.0) /* 1/4 for a linear body, .27 for a corotational one, 1/2 for one that hardens */

/* The frame in which the constant factor of a body that turns is used: turned with each node (default), with
 * each connected piece, or as it is (the source's form, which explodes after a turn of 5 degrees). The last
 * takes in place of K its isotropic majorant (2 mu + 3 lambda) L (x) I, L the Laplacian: it bounds the
 * corotational stiffness whatever turns, but is far too heavy for slender bodies, and stiffness damping is
 * the majorant's, too. */
typedef enum sfem_frame {
    SFEM_FRAME_NODE,
    SFEM_FRAME_PIECE,
    SFEM_FRAME_REST,
    SFEM_FRAME_MAJORANT
} sfem_frame;

enum { SFEM_AXIS_X = 1, SFEM_AXIS_Y = 2, SFEM_AXIS_Z = 4, SFEM_AXIS_ALL = 7 };

typedef struct sfem_body sfem_body;

/* Newton's iteration. Each one costs a tangent K(u), a factorisation on the one analysis (nothing is
 * allocated), a solve, and a force for each length that the line search tries. It minimises the
 * incremental potential (Armijo), the work of damping included. An exact tangent that makes no
 * positive definite matrix gets more mass for that iteration, or gives way to the projected one.
 * Bodies at ordinary steps take 2 or 3 iterations; violence takes up to 100, and the trapezoidal
 * rule, which gains energy there, may find no solution at all: SFEM_BACKWARD_EULER does. */
typedef struct sfem_newton_def {
    sfem_int iterations;  /* at most, >= 1; 20. With 1 the step is semi-implicit: one solve with the
                           * tangent at its start, never refused, its residual not known */
    sfem_real tolerance;  /* stop at |residual| <= tolerance * the largest of |f|, |F|, |M a|, |D(v)|,
                           * or where the residual is what rounding of positions makes; >= 0, 1e-8 */
    sfem_tangent tangent; /* SFEM_TANGENT_EXACT; another is always taken, in D, too, but converges
                           * linearly: three times as many iterations */
    int no_line_search;
    int accept_best;      /* where it does not converge, take the iterate of least residual and go
                           * on; by default the step fails with SFEM_NOT_CONVERGED, the state as it
                           * was */
    sfem_int load_steps;  /* statics: loads, pins and handles come in at least so many steps, >= 1; 1.
                           * One that fails is halved, down to 1/1024 */
} sfem_newton_def;

typedef struct sfem_newton_info {
    int converged;
    sfem_int iterations;     /* solves */
    sfem_int factorisations;
    sfem_int evaluations;    /* of the forces */
    sfem_int projected;      /* tangents that had to be projected to be positive definite */
    sfem_int load_steps;     /* statics */
    sfem_real residual;      /* relative, see tolerance; the last that was computed */
} sfem_newton_info;

/* A damping force D(v) of the caller's own, beside Rayleigh's; for the implicit methods. Called from the
 * thread that steps. */
typedef struct sfem_damping_force {
    /* adds D(v), N, to force [nodes][3]: it is subtracted from the load, so that v.D(v) >= 0 damps */
    void (*force)(void *user, const sfem_real *v /* [nodes][3] */, sfem_real *force);
    /* adds dD/dv, symmetric, to a matrix on K's pattern (zero when it comes); or NULL: the force is then
     * iterated upon, which converges while h dD/dv stays below the mass, linearly */
    void (*tangent)(void *user, const sfem_real *v, sfem_matrix *tangent);
    void *user;
} sfem_damping_force;

typedef struct sfem_body_def {
    sfem_integrator integrator;
    sfem_real p, q, r;        /* >= 0 (p also SFEM_P_SAFE, _AUTO), >= 0, > 0. Unconditionally stable for p >= 1/4,
                               * q >= 1. r multiplies the mass and nothing else: keep it 1, r = 3 is a
                               * body that falls at g/3. q != 1 adds the mass (q-1) h D/2. */
    sfem_real beta, gamma;    /* of Newmark: beta > 0, gamma >= 1/2 */
    sfem_real rho_inf;        /* of generalized-alpha, 0 to 1; .8 */
    sfem_real hht_alpha;      /* of HHT, 0 (trapezoidal) to 1/3; .1 */
    sfem_newton_def newton;
    sfem_damping_force damping_force; /* all zero: none */
    sfem_start start;
    sfem_frame frame;         /* (p,q,r) of nonlinear laws, as the next three: */
    int no_guard;             /* take every step as it comes, even if it makes energy */
    sfem_int corrections;     /* at most so many solves more a step, toward Newmark(1/4, 1/2) itself */
    sfem_real correction_tolerance; /* stop when one changes the acceleration by less, relatively */
    int plain_load;           /* (p,q,r): F at the start of the step alone, as the source has it, instead
                               * of p F+ + (1-2p) F + p F-, which makes it equal Newmark */
    sfem_real alpha, beta_k;  /* Rayleigh damping of the whole body, added to the model's: 1/s, s. In
                               * the implicit methods K is the current K(u), which brakes a rotation
                               * at the rate beta_k omega^2; what the tets of a model do not share of
                               * alpha and beta acts as at rest */
    sfem_real gravity[3];     /* m/s^2 */
    const sfem_int *pins;     /* [pin_count] nodes eliminated from the matrix; copied */
    const unsigned char *pin_axes; /* [pin_count] which axes are held, SFEM_AXIS_*; NULL: all */
    sfem_int pin_count;
    sfem_int max_handles;     /* handles at a time; memory 9*8*nodes bytes for each in use; of a body that
                               * turns up to 4 times that, and 4 times more for each factor of redone steps */
    sfem_precision precision;
    sfem_ordering ordering;   /* of the factorisation */
    int no_allocation;        /* a step that would have to allocate returns SFEM_NOT_PREPARED instead */
    sfem_allocator allocator;
    sfem_exec exec;
} sfem_body_def;

/* (p,q,r) with p = SFEM_P_SAFE, q = r = 1; Newmark 1/4, 1/2; gravity 0; 16 handles. */
SFEM_DEF sfem_body_def sfem_default_body_def(void);

/* Creates a body at rest in its rest position. Nothing is factored yet. O(nodes).
 *   errors  SFEM_BAD_ARGUMENT, SFEM_NOT_FINITE, SFEM_OUT_OF_MEMORY */
SFEM_DEF sfem_status sfem_body_create(sfem_model *model, const sfem_body_def *def, sfem_body **out,
                                      sfem_error *err);
SFEM_DEF void sfem_body_free(sfem_body *body); /* NULL allowed */

/* Makes whatever a step of h seconds needs and is not there: a factor, unless another body of the model
 * has one with the same matrix and pins; the handles' columns (three solves a handle). Of what runs in
 * a loop, the only function that allocates; set_pins and solve_static do, too. sfem_body_step calls it
 * where it has to. Where Newton's matrix changes, what is made serves steps of any length.
 *   errors  SFEM_BAD_ARGUMENT (h), SFEM_UNSTABLE (names the stable step), SFEM_NOT_SPD (names a node that
 *           nothing holds), SFEM_OUT_OF_MEMORY */
SFEM_DEF sfem_status sfem_body_prepare(sfem_body *body, sfem_real h, sfem_error *err);

/* One step of h seconds: predict, solve, finish. On failure the state is as it was.
 *   errors  those of sfem_body_prepare; SFEM_NOT_PREPARED with no_allocation; SFEM_NOT_FINITE;
 *           where Newton iterates SFEM_NOT_CONVERGED ("the step did not converge: residual 3e-05
 *           after 20 iterations") and SFEM_NOT_SPD
 *   cost    one product with K and one solve, O(nnz(L)) */
SFEM_DEF sfem_status sfem_body_step(sfem_body *body, sfem_real h, sfem_error *err);

/* The same in three parts, for callers who put forces and constraints of their own (contact) between
 * them. predict fills the right side; sfem_body_rhs points at it until solve: a force added there acts
 * during this step, as F at its start does. solve leaves the step's acceleration where
 * sfem_body_acceleration points. finish takes the step. predict may be called again to give a step up. */
SFEM_DEF sfem_status sfem_body_predict(sfem_body *body, sfem_real h, sfem_error *err);
SFEM_DEF sfem_status sfem_body_solve(sfem_body *body, sfem_error *err);
SFEM_DEF sfem_status sfem_body_finish(sfem_body *body, sfem_error *err);
SFEM_DEF sfem_real *sfem_body_rhs(sfem_body *body);          /* [nodes][3], N */
SFEM_DEF sfem_real *sfem_body_acceleration(sfem_body *body); /* [nodes][3], m/s^2; only to be read where
                                                               * the method is implicit */

/* How the last implicit step (SFEM_BATHE: its two systems together) or nonlinear static solution went,
 * also where it failed. All zero before. */
SFEM_DEF sfem_newton_info sfem_body_newton(const sfem_body *body);

/* Static equilibrium f(u) = F under the forces, gravity, pins and handles of now; velocity becomes
 * zero. Handles that are nodes count as pins here. Where all laws are linear that is one solve;
 * else Newton's iteration from the present u, in steps of the load that are halved where one fails
 * (sfem_newton_def; sfem_body_newton tells how it went). It may be one equilibrium of several.
 *   errors  SFEM_NOT_SPD: "node 17 is held by nothing" and the like; SFEM_NOT_CONVERGED (how much of
 *           the load was reached), SFEM_NOT_FINITE, SFEM_OUT_OF_MEMORY: the state is as it was */
SFEM_DEF sfem_status sfem_body_solve_static(sfem_body *body, sfem_error *err);

/* Loads. force [nodes][3] (NULL: none) is the load at the end of the next step and stays until changed;
 * before the first step it is the load at the start as well, unless sfem_body_start is called between
 * the two: it fixes the load, and the acceleration, at time 0. */
SFEM_DEF sfem_status sfem_body_set_force(sfem_body *body, const sfem_real *force, sfem_error *err);
SFEM_DEF sfem_status sfem_body_add_node_force(sfem_body *body, sfem_int node, const sfem_real f[3],
                                              sfem_error *err);
SFEM_DEF sfem_status sfem_body_set_gravity(sfem_body *body, const sfem_real g[3], sfem_error *err);
SFEM_DEF void sfem_body_start(sfem_body *body);

/* State. displacement points at u [nodes][3]; positions and velocities are written to the caller's
 * arrays. A new state starts the integrator afresh at the body's time; NULL means zero. Pinned axes keep
 * their pins' place and no velocity. */
SFEM_DEF const sfem_real *sfem_body_displacement(const sfem_body *body);
SFEM_DEF void sfem_body_positions(const sfem_body *body, sfem_real *x);
SFEM_DEF void sfem_body_velocities(const sfem_body *body, sfem_real *v);
/* The same as floats, for rendering: three for node i at i stride bytes from the first; either may be
 * NULL. Takes no memory and reads nothing but the state. */
SFEM_DEF void sfem_body_to_floats(const sfem_body *body, float *x, float *v, size_t stride);
SFEM_DEF sfem_status sfem_body_set_state(sfem_body *body, const sfem_real *u, const sfem_real *v,
                                         sfem_error *err);
SFEM_DEF sfem_real sfem_body_time(const sfem_body *body); /* s */

/* The whole state as one block of bytes: save and load it on the same build and machine, into any body of
 * the same model, pins and max_handles. It is checksummed; a block that does not fit is refused.
 *   errors  SFEM_FORMAT (not a state, damaged), SFEM_MISMATCH (of another body) */
SFEM_DEF size_t sfem_body_state_size(const sfem_body *body);
SFEM_DEF void sfem_body_save_state(const sfem_body *body, void *memory);
SFEM_DEF sfem_status sfem_body_load_state(sfem_body *body, const void *memory, size_t bytes,
                                          sfem_error *err);

typedef struct sfem_energy {
    sfem_real kinetic, elastic, load; /* 1/2 v.Mv, Psi(u), -(F + Mg).u; J */
    sfem_real total;                  /* their sum */
    sfem_real conserved; /* what the integrator conserves exactly, undamped and under constant load, and for a
                          * nonlinear body nearly, without the motion of free pieces' centres of mass: for
                          * its guarded steps 1/2 w.r M w + (E + E-)/2 + (p - 1/2)(u-u-).(f-f-)/2
                          * - F.(u+u-)/2, after a step done again 1/2 w.r M w + E - F.u; for a linear body
                          * and (p,q,r) 1/2 w.(r M + p h^2 K) w + (E + E-)/2 - (u-u-).(f-f-)/4 - F.(u+u-)/2,
                          * for Newmark(beta, 1/2) the total + (beta - 1/4) h^2/2 a.M a */
} sfem_energy;
SFEM_DEF sfem_energy sfem_body_energy(sfem_body *body); /* two products with K; allocates nothing */

typedef struct sfem_body_info {
    sfem_int nodes, tets, free_nodes;
    sfem_real p;              /* the p in use, after SFEM_P_AUTO */
    sfem_real omega_max;      /* 1/s, upper estimate; 0 while nothing has asked for it */
    sfem_real stable_step;    /* s; 0 means no limit */
    int diagonal;             /* the step needs no factor */
    size_t factor_nnz;        /* scalars in L */
    size_t factor_bytes, body_bytes;
    sfem_int factor_users;    /* bodies that share the factor */
    sfem_int factors_made;    /* by this body, since it was created */
    int64_t steps, redone;    /* since its state was set; redone: by the guard, */
    int64_t descents;         /* with so many steps of descent, a solve each */
    sfem_int corrections;     /* in the last step */
} sfem_body_info;
SFEM_DEF sfem_body_info sfem_body_get_info(const sfem_body *body);

/* Pins hold a node where it was when it was pinned. Those of the definition are eliminated; this call
 * replaces them all, and the next step prepares a new factor. move_pin sets where a pinned node is to be
 * at the end of the next step. A reaction is the force of the support on the body, N, in the present
 * state, by the equation of motion; zero on axes that are not held. */
SFEM_DEF sfem_status sfem_body_set_pins(sfem_body *body, sfem_int count, const sfem_int *pins,
                                        const unsigned char *axes, sfem_error *err);
SFEM_DEF sfem_status sfem_body_move_pin(sfem_body *body, sfem_int node, const sfem_real position[3],
                                        sfem_error *err);
SFEM_DEF void sfem_body_reactions(sfem_body *body, sfem_real *force /* [nodes][3] */);

/* Handles take hold of a node, or of a point inside a tet (barycentric coordinates), while the body runs,
 * without a new factor: with H the 3 rows of a handle, u' = u0' + A^-1 H^T l where H x' is the target.
 * A handle's number stays its own until it is released. The force is that of the hand on the body over
 * the last step, N. Handles that others already determine (five points of one tet) carry no force.
 *   errors  SFEM_FULL past max_handles: pin the nodes instead; SFEM_BAD_ARGUMENT (pinned node, ...) */
SFEM_DEF sfem_status sfem_body_grab_node(sfem_body *body, sfem_int node, sfem_int *handle,
                                         sfem_error *err);
SFEM_DEF sfem_status sfem_body_grab_point(sfem_body *body, sfem_int tet, const sfem_real bary[4],
                                          sfem_int *handle, sfem_error *err);
SFEM_DEF sfem_status sfem_body_move_handle(sfem_body *body, sfem_int handle, const sfem_real target[3],
                                           sfem_error *err);
SFEM_DEF void sfem_body_release_handle(sfem_body *body, sfem_int handle);
SFEM_DEF void sfem_body_handle_force(const sfem_body *body, sfem_int handle, sfem_real force[3]);
SFEM_DEF void sfem_body_handle_position(const sfem_body *body, sfem_int handle, sfem_real x[3]);

/* ============================================================================================
 * >>api-modes   eigenvalues and modes
 * ============================================================================================ */

/* K phi = lambda M phi: the lowest modes of a model at rest, phi_i.M phi_j = delta_ij, omega =
 * sqrt(lambda). Block Lanczos on (K - sigma M)^-1 M, four right sides a pass [Lanczos 1950; Golub,
 * Underwood 1977; Ericsson, Ruhe 1980], all vectors kept M-orthogonal, restarted from what it has
 * [Wu, Simon 2000]; and a count: of K - tau M = L S L^T as many signs are negative as eigenvalues lie
 * below tau [Sylvester 1852]. With tau in the gap above the last mode asked for, a mode that Lanczos
 * missed is noticed; a new random block, orthogonal to all that is known, then finds it. */
typedef struct sfem_modes_def {
    sfem_int modes;           /* so many of the lowest, rigid ones not counted; >= 0, 20 */
    sfem_real below_hz;       /* > 0: instead, all below this frequency, as many as there are */
    int rigid;                /* return the rigid modes too, first; else they are only kept out */
    const sfem_int *pins;     /* [pin_count] nodes held, as in sfem_body_def */
    const unsigned char *pin_axes; /* [pin_count] which axes of them, SFEM_AXIS_*; NULL: all */
    sfem_int pin_count;
    sfem_real tolerance;      /* of the backward error, see below; 1e-13, from 1e-15 to 1e-2 */
    int dense;                /* by sfem_dense_eigen: O(n^3), 72 n^2 bytes, n free nodes. Bodies of so few
                               * axes that Lanczos has no room for its basis are solved so anyway */
    int no_proof;             /* spare the count, and the factorisation that it needs */
    sfem_int max_basis;       /* Lanczos vectors at most; 0: 3 modes + 100 or 1.5 modes + 250, the less */
    sfem_int max_restarts;    /* 0: 40 */
    uint32_t seed;            /* of the random start */
    sfem_ordering ordering;   /* of the factorisation */
    sfem_allocator allocator; /* of the result, and of all that is made on the way */
    sfem_exec exec;
} sfem_modes_def;

typedef struct sfem_modes_info {
    int dense;                /* by the dense solver */
    int proved;               /* no mode below the last is missing: counted */
    sfem_int converged;       /* elastic modes within the tolerance: all, or it is an error */
    sfem_int solves;          /* right sides solved for */
    sfem_int steps;           /* passes of four of them, but for those of polishing */
    sfem_int restarts;        /* thick ones, and those for what was missing */
    sfem_int recovered;       /* modes that only the count brought to light */
    sfem_int factorisations;
    sfem_int basis;           /* most vectors at a time */
    sfem_int below;           /* counted eigenvalues below `bound`, rigid ones among them; -1: not */
    sfem_real bound, sigma;   /* 1/s^2, tau and sigma as above */
    sfem_int cut;             /* further modes that differ from the last by less than 1e-6 of its
                               * lambda and were not asked for: it splits a multiple one. -1: not known */
} sfem_modes_info;

typedef struct sfem_modes {
    sfem_int nodes, count, rigid; /* rigid of the count come first, with lambda = 0 */
    sfem_real *lambda; /* [count] 1/s^2, ascending */
    sfem_real *phi;    /* [count][nodes][3] kg^-1/2; zero where pinned */
    sfem_real *error;  /* [count] backward error |K phi - lambda M phi| / ((|K| + lambda |M|) |phi|),
                        * |K| the largest sum of a row's absolute values, |phi| Euclidean */
    sfem_modes_info info;
    sfem_allocator allocator;
} sfem_modes;

SFEM_DEF sfem_modes_def sfem_default_modes_def(void);

/* Fills *out, whatever it held; sfem_modes_free it afterwards.
 *
 * A piece is what hangs together by its nodes. Its rigid motions are those of six that its pins allow
 * (two held axes of an edge leave a hinge): they are built from the coordinates, exactly, piece by
 * piece, and Lanczos works beside them. Pieces that meet in a node or an edge only move against each
 * other without strain; that shows as elastic modes with lambda near 0. Nodes in no tet stay still.
 *
 * Of a multiple eigenvalue the vectors are some basis of its space. Where the last of `modes` splits
 * one, so many of its copies are returned as were asked for: info.cut says how many were left out. An
 * eigenvalue within 1e-8 of below_hz may count as below or not.
 *
 *   errors  SFEM_BAD_ARGUMENT   modes < 0 or more than there are, a pin, a tolerance; below_hz not
 *                               finite
 *           SFEM_NOT_CONVERGED  which mode, and how far off
 *           SFEM_NOT_SPD        K - sigma M has lost its sign: a stiffness of 0, or digits run out
 *           SFEM_SINGULAR       no bound in the gap above the last mode could be counted at, or the
 *                               count keeps exceeding what is found
 *           SFEM_OUT_OF_MEMORY, SFEM_TOO_LARGE
 *   cost    two factorisations and about 5 right sides for each mode, four of them together for the
 *           price of two alone; memory for the factor and max_basis + 30 vectors. Where rounding leaves
 *           an error above the tolerance (slender bodies, many modes), a third factorisation and a
 *           pass over the modes; what is then still above it is to be read in `error`, and no failure.
 *           Same bits for any number of threads. */
SFEM_DEF sfem_status sfem_modes_create(sfem_model *model, const sfem_modes_def *def, sfem_modes *out,
                                       sfem_error *err);
SFEM_DEF void sfem_modes_free(sfem_modes *modes); /* all zero afterwards; NULL allowed */

SFEM_DEF sfem_real sfem_modes_hz(const sfem_modes *modes, sfem_int k); /* sqrt(lambda) / 2 pi */

/* ============================================================================================
 * >>api-reduced   modal bodies: oscillators, warping, handles
 * ============================================================================================ */

/* ============================================================================================
 * >>api-link   modal motion over a lossy link
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
/* Vector paths. Kernels stand once, in section >>kernels at the end of the implementation, and are
 * compiled once for each path by including this file again; SFEMI_PATH tells which. */
#if defined(__GNUC__) && defined(__x86_64__) && !defined(SFEM_NO_DISPATCH)
#define SFEMI_X86 1
#include <immintrin.h>
#else
#define SFEMI_X86 0
#endif
#if defined(__FMA__) && !SFEMI_X86
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif
#if defined(__unix__) || defined(__APPLE__)
#include <sched.h>
#define SFEMI_YIELD() (void)sched_yield()
#else
#define SFEMI_YIELD() (void)0
#endif
#include <time.h>
#ifndef SFEM_SELF
#define SFEM_SELF "softfem.h"
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

/* The vector path of this processor: 0 portable, 1 AVX2 with FMA, 2 AVX-512F. SFEM_FORCE_PATH takes one
 * whatever the processor says. Costs a few loads: ask once for each loop, not once for each element.
 *
 * A kernel is a function SFEMI_KERNEL(name) in section >>kernels, marked SFEMI_TARGET; its instances
 * are called name_0, name_1, name_2, and a table of pointers for each path, like sfemi_ldl_kernels,
 * chooses between them. Inside it SFEMI_V is a vector of SFEMI_W numbers of type SFEMI_R, with
 * SFEMI_LD, SFEMI_ST, SFEMI_DUP, SFEMI_ADD, SFEMI_MUL, SFEMI_FMA (a b + c) and SFEMI_FNMA
 * (c - a b). Multiply-adds are explicit, so that the bits depend on the path and on nothing else. */
static int sfemi_path(void)
{
#if defined(SFEM_FORCE_PATH) && SFEMI_X86
    return SFEM_FORCE_PATH;
#elif SFEMI_X86
    if (__builtin_cpu_supports("avx512f")) return 2;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return 1;
    return 0;
#else
    return 0;
#endif
}

#if defined(__GNUC__)
#define SFEMI_INLINE inline __attribute__((always_inline))
#else
#define SFEMI_INLINE inline
#endif

/* For kernels that vector types would only obscure: loops over lanes that the compiler turns into
 * vector instructions of the given set. */
#if SFEMI_X86
#define SFEMI_AVX2   __attribute__((target("avx2,fma")))
#define SFEMI_AVX512 __attribute__((target("avx512f,avx2,fma")))
#endif

SFEM_DEF int sfem_vector_width(void)
{
    static const int width[3] = {1, 4, 8};
    return width[sfemi_path()];
}

/* ============================================================================================
 * >>math   3-vectors, 3x3 matrices (row-major), polar and singular value decomposition
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

/* c = a b, a^T b, a b^T. c must be neither. */
static void sfemi_mul3(const sfem_real *a, const sfem_real *b, sfem_real *c)
{
    int i;
    for (i = 0; i < 9; i += 3) {
        c[i] = a[i] * b[0] + a[i + 1] * b[3] + a[i + 2] * b[6];
        c[i + 1] = a[i] * b[1] + a[i + 1] * b[4] + a[i + 2] * b[7];
        c[i + 2] = a[i] * b[2] + a[i + 1] * b[5] + a[i + 2] * b[8];
    }
}

static void sfemi_mul3_tn(const sfem_real *a, const sfem_real *b, sfem_real *c)
{
    int i;
    for (i = 0; i < 3; ++i) {
        c[3 * i] = a[i] * b[0] + a[3 + i] * b[3] + a[6 + i] * b[6];
        c[3 * i + 1] = a[i] * b[1] + a[3 + i] * b[4] + a[6 + i] * b[7];
        c[3 * i + 2] = a[i] * b[2] + a[3 + i] * b[5] + a[6 + i] * b[8];
    }
}

static void sfemi_mul3_nt(const sfem_real *a, const sfem_real *b, sfem_real *c)
{
    int i;
    for (i = 0; i < 9; i += 3) {
        c[i] = sfemi_dot3(a + i, b);
        c[i + 1] = sfemi_dot3(a + i, b + 3);
        c[i + 2] = sfemi_dot3(a + i, b + 6);
    }
}

/* d(det f)/df; f:c = 3 det f. */
static void sfemi_cofactor3(const sfem_real *f, sfem_real *c)
{
    sfemi_cross(f + 3, f + 6, c);
    sfemi_cross(f + 6, f, c + 3);
    sfemi_cross(f, f + 3, c + 6);
}

/* One Jacobi rotation [Jacobi 1846; Rutishauser 1966]: the tangent of the angle, at most 45
 * degrees, that zeroes the off-diagonal entry pq of a symmetric matrix. */
static sfem_real sfemi_jacobi_tangent(sfem_real pp, sfem_real qq, sfem_real pq)
{
    const sfem_real d = qq - pp, t = 2 * pq / (fabs(d) + sqrt(d * d + 4 * pq * pq));
    return d < 0 ? -t : t;
}

/* Eigenvalues w [n], descending, and eigenvectors, the columns of v [n][n], of the symmetric
 * matrix a [n][n], which is destroyed: cyclic Jacobi, for n up to a dozen. det v = 1. */
static void sfemi_sym_eigen(int n, sfem_real *a, sfem_real *w, sfem_real *v)
{
    sfem_real norm = 0;
    int sweep, turned = 1, p, q, i;
    for (i = 0; i < n * n; ++i) {
        norm += a[i] * a[i];
        v[i] = i % (n + 1) ? 0 : 1;
    }
    norm = 2e-16 * sqrt(norm); /* the rounding error */
    for (sweep = 0; sweep < 30 && turned; ++sweep) {
        turned = 0;
        for (p = 0; p < n - 1; ++p) {
            for (q = p + 1; q < n; ++q) {
                sfem_real t, c, s;
                if (!(fabs(a[n * p + q]) > norm)) continue;
                t = sfemi_jacobi_tangent(a[n * p + p], a[n * q + q], a[n * p + q]);
                c = 1 / sqrt(1 + t * t);
                s = t * c;
                turned = 1;
                a[n * p + p] -= t * a[n * p + q];
                a[n * q + q] += t * a[n * p + q];
                a[n * p + q] = a[n * q + p] = 0;
                for (i = 0; i < n; ++i) {
                    const sfem_real vp = v[n * i + p], vq = v[n * i + q];
                    v[n * i + p] = c * vp - s * vq;
                    v[n * i + q] = s * vp + c * vq;
                    if (i != p && i != q) {
                        const sfem_real ap = a[n * p + i], aq = a[n * q + i];
                        a[n * p + i] = a[n * i + p] = c * ap - s * aq;
                        a[n * q + i] = a[n * i + q] = s * ap + c * aq;
                    }
                }
            }
        }
    }
    for (i = 0; i < n; ++i) w[i] = a[(n + 1) * i];
    for (p = 0; p < n - 1; ++p) { /* selection sort; a turn by 90 degrees keeps det v */
        for (q = p, i = p + 1; i < n; ++i)
            if (w[i] > w[q]) q = i;
        if (q == p) continue;
        norm = w[p], w[p] = w[q], w[q] = norm;
        for (i = 0; i < n; ++i) {
            norm = v[n * i + p];
            v[n * i + p] = v[n * i + q];
            v[n * i + q] = -norm;
        }
    }
}

/* Turns columns p and q of b and v, n x n, so that those of b are orthogonal; 0 if they were.
 * Sweeps of it over all pairs give B = F V with orthogonal columns, for B = F and V = I at the
 * start: the singular value decomposition, its small values to their own rounding error
 * [Hestenes 1958]. */
static int sfemi_svd_turn(int n, sfem_real *b, sfem_real *v, int p, int q)
{
    sfem_real pp = 0, qq = 0, pq = 0, t, c, s;
    int i;
    for (i = 0; i < n * n; i += n) {
        pp += b[i + p] * b[i + p];
        qq += b[i + q] * b[i + q];
        pq += b[i + p] * b[i + q];
    }
    if (!(pq * pq > 1e-31 * pp * qq)) return 0;
    t = sfemi_jacobi_tangent(pp, qq, pq);
    c = 1 / sqrt(1 + t * t);
    s = t * c;
    for (i = 0; i < n * n; i += n) {
        const sfem_real bp = b[i + p], bq = b[i + q], vp = v[i + p], vq = v[i + q];
        b[i + p] = c * bp - s * bq;
        b[i + q] = s * bp + c * bq;
        v[i + p] = c * vp - s * vq;
        v[i + q] = s * vp + c * vq;
    }
    return 1;
}

/* axis = the unit vector along b less its part along the unit vector `before` (NULL: none);
 * where nothing is left of b, the same of the first of the columns k, k+1, .. of v that leaves
 * enough. */
static void sfemi_svd_axis(const sfem_real b[3], const sfem_real *before, const sfem_real v[9],
                           int k, sfem_real axis[3])
{
    sfem_real length = 0, size, along;
    int tries, pass, i;
    memcpy(axis, b, 3 * sizeof *axis);
    for (tries = 0;; ++tries, ++k) {
        size = sqrt(sfemi_dot3(axis, axis));
        for (pass = 0; before && pass < 2; ++pass) {
            along = sfemi_dot3(axis, before);
            for (i = 0; i < 3; ++i) axis[i] -= along * before[i];
        }
        length = sqrt(sfemi_dot3(axis, axis));
        if ((length > .5 * size && length > 1e-150) || tries == 3) break;
        for (i = 0; i < 3; ++i) axis[i] = v[3 * i + k % 3];
    }
    for (i = 0; i < 3; ++i) axis[i] /= length;
}

/* Columns p and q of a 3x3 matrix change places; one changes its sign: a turn by 90 degrees. */
static void sfemi_swap3(sfem_real *a, int p, int q)
{
    int i;
    for (i = 0; i < 9; i += 3) {
        const sfem_real t = a[i + p];
        a[i + p] = a[i + q];
        a[i + q] = -t;
    }
}

SFEM_DEF void sfem_signed_svd(const sfem_real f[9], sfem_real u[9], sfem_real s[3], sfem_real v[9])
{
    sfem_real b[9], column[3][3], axis[3][3], size[3], scale = 0, t;
    int sweep, turned = 1, i, j, k;
    SFEM_ASSERT(f && u && s && v);
    for (i = 0; i < 9; ++i) {
        if (!(fabs(f[i]) <= scale)) scale = fabs(f[i]);
        v[i] = i % 4 ? 0 : 1;
    }
    if (!(scale > 0)) scale = 1;
    for (i = 0; i < 9; ++i)
        b[i] = fabs(f[i] / scale) < 1e-150 ? 0 : f[i] / scale; /* squares are next */
    for (sweep = 0; sweep < 20 && turned; ++sweep) {           /* b = f v / scale */
        turned = sfemi_svd_turn(3, b, v, 0, 1);
        turned |= sfemi_svd_turn(3, b, v, 0, 2);
        turned |= sfemi_svd_turn(3, b, v, 1, 2);
    }
    for (j = 0; j < 3; ++j) size[j] = b[j] * b[j] + b[3 + j] * b[3 + j] + b[6 + j] * b[6 + j];
    for (j = 0; j < 2; ++j) { /* descending */
        for (k = j, i = j + 1; i < 3; ++i)
            if (size[i] > size[k]) k = i;
        if (k == j) continue;
        t = size[j], size[j] = size[k], size[k] = t;
        sfemi_swap3(b, j, k);
        sfemi_swap3(v, j, k);
    }
    for (i = 0; i < 9; ++i) column[i % 3][i / 3] = b[i];
    sfemi_svd_axis(column[0], NULL, v, 0, axis[0]);
    sfemi_svd_axis(column[1], axis[0], v, 1, axis[1]);
    sfemi_cross(axis[0], axis[1], axis[2]);
    for (j = 0; j < 3; ++j) s[j] = scale * sfemi_dot3(axis[j], column[j]);
    for (i = 0; i < 9; ++i) u[i] = axis[i % 3][i / 3];
}

/* The nearest rotation R of an ordinary F, or 0. The trace t of S is the largest root of
 *     p(t) = t^4 - 2 |F|^2 t^2 - 8 det F t + |F|^4 - 4 |cof F|^2,
 * whose four roots are real, and R = dt/dF = -(dp/dF)/(dp/dt) [after Lin, Chitalu, Komura
 * 2022]. That loses the square of t^3 / dp/dt in accuracy, dp/dt = 8 (s1+s2)(s2+s3)(s3+s1): F
 * flat or a little inverted is ordinary, F of rank 1 is not. The root is approached from above
 * by Halley's method, which cannot overshoot. */
static int sfemi_polar_fast(const sfem_real f[9], sfem_real r[9])
{
    sfem_real c[9], ftf[9], norm2 = 0, cof2 = 0, det, t, step, slope;
    int k, i, j;
    sfemi_cofactor3(f, c);
    det = sfemi_dot3(f, c);
    for (i = 0; i < 9; ++i) {
        norm2 += f[i] * f[i];
        cof2 += c[i] * c[i];
    }
    t = sqrt(3 * norm2);
    for (k = 0, step = t; k < 8 && step > 1e-6 * t; ++k) { /* cubic: all is gained */
        const sfem_real p = ((t * t - 2 * norm2) * t - 8 * det) * t + norm2 * norm2 - 4 * cof2;
        slope = (t * t - norm2) * t - 2 * det;
        step = p * slope / (4 * slope * slope - p * (1.5 * t * t - .5 * norm2));
        t -= step;
    }
    slope = (t * t - norm2) * t - 2 * det;
    if (!(step <= 1e-6 * t && slope > .1 * t * t * t && norm2 > 1e-60 && norm2 < 1e60)) return 0;
    sfemi_mul3_tn(f, f, ftf);
    for (i = 0; i < 9; i += 3)
        for (j = 0; j < 3; ++j)
            r[i + j] = ((t * t + norm2) * f[i + j] + 2 * t * c[i + j] -
                        2 * (f[i] * ftf[j] + f[i + 1] * ftf[3 + j] + f[i + 2] * ftf[6 + j])) /
                       slope;
    return 1;
}

SFEM_DEF void sfem_polar(const sfem_real f[9], sfem_real r[9], sfem_real s[9])
{
    sfem_real u[9], v[9], w[3], rotation[9];
    int i, j;
    SFEM_ASSERT(f && r);
    if (!sfemi_polar_fast(f, rotation)) {
        sfem_signed_svd(f, u, w, v);
        sfemi_mul3_nt(u, v, rotation);
    }
    if (s) {
        sfemi_mul3_tn(rotation, f, u);
        for (i = 0; i < 3; ++i)
            for (j = 0; j < 3; ++j) s[3 * i + j] = u[3 * i + j] / 2 + u[3 * j + i] / 2;
    }
    memcpy(r, rotation, sizeof rotation);
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

/* --- matrices -------------------------------------------------------------------------------- */

SFEM_DEF void sfem_matrix_free(sfem_matrix *a, const sfem_allocator *allocator)
{
    static const sfem_allocator standard = {0, 0, 0};
    const sfem_allocator *m = allocator ? allocator : &standard;
    if (!a) return;
    sfemi_delete(m, (void *)(uintptr_t)a->row);
    sfemi_delete(m, (void *)(uintptr_t)a->col);
    sfemi_delete(m, a->val);
    memset(a, 0, sizeof *a);
}

/* Adds block b, transposed if asked, to block d. */
static void sfemi_matrix_add(sfem_real *d, const sfem_real *b, int transposed)
{
    int r, c;
    for (r = 0; r < 3; ++r)
        for (c = 0; c < 3; ++c) d[3 * r + c] += transposed ? b[3 * c + r] : b[3 * r + c];
}

SFEM_DEF sfem_status sfem_matrix_create(sfem_int n, sfem_int count, const sfem_int *i,
                                        const sfem_int *j, const sfem_real *block,
                                        const sfem_allocator *allocator, sfem_matrix *out,
                                        sfem_error *err)
{
    static const sfem_allocator standard = {0, 0, 0};
    const sfem_allocator *m = allocator ? allocator : &standard;
    sfem_status status = SFEM_OK;
    sfem_int *bycol = NULL, *start = NULL, *byrow = NULL, *row = NULL, *col = NULL, *place = NULL;
    sfem_real *val = NULL;
    sfem_int e, k, c, blocks;
    SFEM_ASSERT(out && (count == 0 || (i && j)));
    if (n < 0 || count < 0)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "a matrix of %ld rows and %ld blocks", (long)n,
                          (long)count);
    if (n > INT32_MAX / 3 || count > INT32_MAX - n)
        return sfemi_fail(err, SFEM_TOO_LARGE, "%ld rows and %ld blocks overflow an index", (long)n,
                          (long)count);
    for (e = 0; e < count; ++e)
        if (i[e] < 0 || i[e] >= n || j[e] < 0 || j[e] >= n)
            return sfemi_fail(err, SFEM_BAD_ARGUMENT, "block %ld stands at (%ld, %ld) of %ld rows",
                              (long)e, (long)i[e], (long)j[e], (long)n);
    /* sort twice, stably, by column and then by row; numbers from count on are the diagonal */
    SFEMI_NEW(sfem_int, start, m, (size_t)n + 2);
    SFEMI_NEW(sfem_int, bycol, m, (size_t)count + (size_t)n);
    SFEMI_NEW(sfem_int, byrow, m, (size_t)count + (size_t)n);
    SFEMI_NEW(sfem_int, place, m, (size_t)count + (size_t)n);
#define SFEMI_I(e) ((e) >= count ? (e)-count : i[e] > j[e] ? i[e] : j[e])
#define SFEMI_J(e) ((e) >= count ? (e)-count : i[e] > j[e] ? j[e] : i[e])
    for (e = 0; e < count + n; ++e) ++start[SFEMI_J(e) + 1];
    for (c = 0; c < n; ++c) start[c + 1] += start[c];
    for (e = 0; e < count + n; ++e) bycol[start[SFEMI_J(e)]++] = e;
    memset(start, 0, ((size_t)n + 2) * sizeof *start);
    for (e = 0; e < count + n; ++e) ++start[SFEMI_I(e) + 1];
    for (c = 0; c < n; ++c) start[c + 1] += start[c];
    for (k = 0; k < count + n; ++k) byrow[start[SFEMI_I(bycol[k])]++] = bycol[k];
    SFEMI_NEW(sfem_int, row, m, (size_t)n + 1);
    for (blocks = 0, k = 0; k < count + n; ++k) {
        const sfem_int r = SFEMI_I(byrow[k]);
        if (k == 0 || SFEMI_I(byrow[k - 1]) != r || SFEMI_J(byrow[k - 1]) != SFEMI_J(byrow[k])) {
            ++blocks;
            row[r + 1] = blocks;
        }
        place[byrow[k]] = blocks - 1;
    }
    SFEMI_NEW(sfem_int, col, m, (size_t)blocks + 1);
    SFEMI_NEW(sfem_real, val, m, 9 * (size_t)blocks + 1);
    for (e = 0; e < count + n; ++e) {
        col[place[e]] = SFEMI_J(e);
        if (e < count && block)
            sfemi_matrix_add(val + 9 * (size_t)place[e], block + 9 * (size_t)e, i[e] < j[e]);
    }
#undef SFEMI_I
#undef SFEMI_J
    memset(out, 0, sizeof *out);
    out->n = n;
    out->row = row;
    out->col = col;
    out->val = val;
    row = col = NULL;
    val = NULL;
done:
    sfemi_delete(m, bycol);
    sfemi_delete(m, byrow);
    sfemi_delete(m, start);
    sfemi_delete(m, place);
    sfemi_delete(m, row);
    sfemi_delete(m, col);
    sfemi_delete(m, val);
    return status;
}

/* The pattern alone, O(blocks). */
static sfem_status sfemi_matrix_check_pattern(const sfem_matrix *a, sfem_error *err)
{
    sfem_int i, k;
    if (a->n < 0 || a->n > INT32_MAX / 3)
        return sfemi_fail(err, a->n < 0 ? SFEM_BAD_ARGUMENT : SFEM_TOO_LARGE,
                          "a matrix of %ld block rows", (long)a->n);
    if (a->n == 0) return SFEM_OK;
    if (a->row[0] != 0)
        return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, 0, -1, "row 0 starts at block %ld, not 0",
                             (long)a->row[0]);
    for (i = 0; i < a->n; ++i) {
        if (a->row[i + 1] <= a->row[i] || a->col[a->row[i + 1] - 1] != i)
            return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, i, -1,
                                 "row %ld does not end with its diagonal block", (long)i);
        for (k = a->row[i]; k < a->row[i + 1]; ++k)
            if (a->col[k] < 0 || (k > a->row[i] && a->col[k] <= a->col[k - 1]))
                return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, i, -1,
                                     "the columns of row %ld do not ascend", (long)i);
    }
    return SFEM_OK;
}

static sfem_status sfemi_matrix_check_values(const sfem_matrix *a, sfem_error *err)
{
    sfem_int i, k;
    int c;
    for (i = 0; i < a->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1]; ++k)
            for (c = 0; c < 9; ++c)
                if (!sfemi_finite(a->val[9 * (size_t)k + (size_t)c]))
                    return sfemi_fail_at(err, SFEM_NOT_FINITE, i, -1,
                                         "block (%ld, %ld) of the matrix is not finite", (long)i,
                                         (long)a->col[k]);
    return SFEM_OK;
}

SFEM_DEF sfem_status sfem_matrix_check(const sfem_matrix *a, sfem_error *err)
{
    const sfem_status status = sfemi_matrix_check_pattern(a, err);
    return status != SFEM_OK ? status : sfemi_matrix_check_values(a, err);
}

SFEM_DEF sfem_status sfem_matrix_upper_create(const sfem_matrix *a, const sfem_allocator *allocator,
                                              sfem_matrix_upper *out, sfem_error *err)
{
    static const sfem_allocator standard = {0, 0, 0};
    const sfem_allocator *m = allocator ? allocator : &standard;
    sfem_status status = SFEM_OK;
    sfem_matrix_upper u;
    sfem_int i, k;
    memset(&u, 0, sizeof u);
    u.n = a->n;
    u.allocator = *m;
    SFEMI_NEW(sfem_int, u.start, m, (size_t)a->n + 2);
    for (i = 0; i < a->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1] - 1; ++k) ++u.start[a->col[k] + 2];
    for (i = 0; i < a->n; ++i) u.start[i + 2] += u.start[i + 1];
    SFEMI_NEW(sfem_int, u.row, m, (size_t)u.start[a->n + 1] + 1);
    SFEMI_NEW(sfem_int, u.entry, m, (size_t)u.start[a->n + 1] + 1);
    for (i = 0; i < a->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1] - 1; ++k) {
            const sfem_int p = u.start[a->col[k] + 1]++;
            u.row[p] = i;
            u.entry[p] = k;
        }
    *out = u;
    return SFEM_OK;
done:
    sfem_matrix_upper_free(&u);
    return status;
}

SFEM_DEF void sfem_matrix_upper_free(sfem_matrix_upper *u)
{
    if (!u) return;
    sfemi_delete(&u->allocator, u->start);
    sfemi_delete(&u->allocator, u->row);
    sfemi_delete(&u->allocator, u->entry);
    memset(u, 0, sizeof *u);
}

/* y += B x and y += B^T x for a 3x3 block. */
static void sfemi_block_times(const sfem_real *b, const sfem_real *x, sfem_real *y)
{
    y[0] += b[0] * x[0] + b[1] * x[1] + b[2] * x[2];
    y[1] += b[3] * x[0] + b[4] * x[1] + b[5] * x[2];
    y[2] += b[6] * x[0] + b[7] * x[1] + b[8] * x[2];
}

static void sfemi_block_times_transposed(const sfem_real *b, const sfem_real *x, sfem_real *y)
{
    y[0] += b[0] * x[0] + b[3] * x[1] + b[6] * x[2];
    y[1] += b[1] * x[0] + b[4] * x[1] + b[7] * x[2];
    y[2] += b[2] * x[0] + b[5] * x[1] + b[8] * x[2];
}

#define SFEMI_MATRIX_ROWS 1024 /* rows of one task */

typedef struct sfemi_matrix_job {
    const sfem_matrix *a;
    const sfem_real *x;
    sfem_real *y;
} sfemi_matrix_job;

static void sfemi_matrix_gather(void *data, sfem_int task)
{
    const sfemi_matrix_job *job = (const sfemi_matrix_job *)data;
    const sfem_matrix *a = job->a;
    const sfem_matrix_upper *u = a->upper;
    const sfem_int first = task * SFEMI_MATRIX_ROWS;
    const sfem_int last = first + SFEMI_MATRIX_ROWS < a->n ? first + SFEMI_MATRIX_ROWS : a->n;
    sfem_int i, k;
    for (i = first; i < last; ++i) {
        sfem_real s[3] = {0, 0, 0};
        for (k = a->row[i]; k < a->row[i + 1]; ++k)
            sfemi_block_times(a->val + 9 * (size_t)k, job->x + 3 * (size_t)a->col[k], s);
        for (k = u->start[i]; k < u->start[i + 1]; ++k)
            sfemi_block_times_transposed(a->val + 9 * (size_t)u->entry[k],
                                         job->x + 3 * (size_t)u->row[k], s);
        memcpy(job->y + 3 * (size_t)i, s, sizeof s);
    }
}

SFEM_DEF void sfem_matrix_multiply(const sfem_matrix *a, const sfem_real *x, sfem_real *y,
                                   const sfem_exec *exec)
{
    sfem_int i, k;
    SFEM_ASSERT(a && (a->n == 0 || (x && y && x != y)));
    if (a->upper) {
        sfemi_matrix_job job;
        job.a = a;
        job.x = x;
        job.y = y;
        sfemi_run(exec, (a->n + SFEMI_MATRIX_ROWS - 1) / SFEMI_MATRIX_ROWS, sfemi_matrix_gather,
                  &job);
        return;
    }
    for (i = 0; i < a->n; ++i) {
        const sfem_real *xi = x + 3 * (size_t)i;
        sfem_real s[3] = {0, 0, 0};
        for (k = a->row[i]; k < a->row[i + 1] - 1; ++k) {
            const sfem_real *b = a->val + 9 * (size_t)k;
            const size_t j = 3 * (size_t)a->col[k];
            sfemi_block_times(b, x + j, s);
            sfemi_block_times_transposed(b, xi, y + j);
        }
        sfemi_block_times(a->val + 9 * (size_t)k, xi, s);
        memcpy(y + 3 * (size_t)i, s, sizeof s);
    }
}

SFEM_DEF size_t sfem_matrix_csr_count(const sfem_matrix *a)
{
    return a->n ? 9 * (2 * (size_t)a->row[a->n] - (size_t)a->n) : 0;
}

SFEM_DEF sfem_status sfem_matrix_to_csr(const sfem_matrix *a, sfem_int *row, sfem_int *col,
                                        sfem_real *val, sfem_error *err)
{
    sfem_int i, k, at = 0;
    int r, c;
    if (sfem_matrix_csr_count(a) > (size_t)INT32_MAX)
        return sfemi_fail(err, SFEM_TOO_LARGE, "%lu scalar entries overflow an index",
                          (unsigned long)sfem_matrix_csr_count(a));
    for (i = 0; i <= 3 * a->n; ++i) row[i] = 0;
    for (i = 0; i < a->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1]; ++k) {
            row[3 * i] += 3; /* the width of block row i, which is turned into starts below */
            if (a->col[k] != i) row[3 * a->col[k]] += 3;
        }
    for (i = 0; i < a->n; ++i) {
        const sfem_int width = row[3 * i];
        for (r = 0; r < 3; ++r, at += width) row[3 * i + r] = at;
    }
    /* by block rows, first the lower half: the columns of each row ascend, as row i gets its upper
     * blocks from later rows; row[] is a cursor and is put back at the end */
    for (i = 0; i < a->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1]; ++k)
            for (r = 0; r < 3; ++r)
                for (c = 0; c < 3; ++c) {
                    const sfem_int j = a->col[k];
                    const sfem_real v = a->val[9 * (size_t)k + (size_t)(3 * r + c)];
                    col[row[3 * i + r]] = 3 * j + c;
                    val[row[3 * i + r]++] = v;
                    if (j == i) continue;
                    col[row[3 * j + c]] = 3 * i + r;
                    val[row[3 * j + c]++] = v;
                }
    for (i = 3 * a->n; i > 0; --i) row[i] = row[i - 1];
    row[0] = 0;
    return SFEM_OK;
}

SFEM_DEF void sfem_matrix_to_dense(const sfem_matrix *a, sfem_real *full)
{
    const size_t n = 3 * (size_t)a->n;
    sfem_int i, k;
    size_t r, c;
    memset(full, 0, n * n * sizeof *full);
    for (i = 0; i < a->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1]; ++k)
            for (r = 0; r < 3; ++r)
                for (c = 0; c < 3; ++c) {
                    const size_t p = 3 * (size_t)i + r, q = 3 * (size_t)a->col[k] + c;
                    full[p * n + q] = a->val[9 * (size_t)k + 3 * r + c];
                    if (a->col[k] != i) full[q * n + p] = full[p * n + q];
                }
}

/* --- ordering --------------------------------------------------------------------------------
 * Everything here works on the graph of the nodes; a node is three rows of the matrix. */

typedef struct sfemi_graph { /* neighbours of i: adj[start[i]] ... adj[start[i+1] - 1], without i */
    sfem_int n;
    sfem_int *start, *adj;
} sfemi_graph;

static void sfemi_graph_free(const sfem_allocator *m, sfemi_graph *g)
{
    sfemi_delete(m, g->start);
    sfemi_delete(m, g->adj);
    memset(g, 0, sizeof *g);
}

static sfem_status sfemi_graph_create(const sfem_matrix *a, const sfem_allocator *m,
                                      sfemi_graph *out, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfemi_graph g = {0, NULL, NULL};
    sfem_int i, k;
    g.n = a->n;
    if (a->n && a->row[a->n] > INT32_MAX / 2)
        return sfemi_fail(err, SFEM_TOO_LARGE, "%ld blocks overflow the graph's index",
                          (long)a->row[a->n]);
    SFEMI_NEW(sfem_int, g.start, m, (size_t)a->n + 2);
    for (i = 0; i < a->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1] - 1; ++k) {
            ++g.start[i + 2];
            ++g.start[a->col[k] + 2];
        }
    for (i = 0; i < a->n; ++i) g.start[i + 2] += g.start[i + 1];
    SFEMI_NEW(sfem_int, g.adj, m, (size_t)g.start[a->n + 1] + 1);
    for (i = 0; i < a->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1] - 1; ++k) {
            g.adj[g.start[i + 1]++] = a->col[k];
            g.adj[g.start[a->col[k] + 1]++] = i;
        }
    *out = g;
    return SFEM_OK;
done:
    sfemi_graph_free(m, &g);
    return status;
}

/* Approximate minimum degree [Amestoy, Davis, Duff 1996] on a quotient graph: a live variable has a
 * list of elements and then of variables, an element (an eliminated pivot) a list of variables. */
typedef struct sfemi_amd {
    sfem_int n, space, used;
    sfem_int *list;     /* [space] all lists */
    sfem_int *spare;    /* [space] the other half of the garbage collector */
    sfem_int *at;       /* [n] where the list starts */
    sfem_int *length;   /* [n] */
    sfem_int *elements; /* [n] how many of it are elements */
    sfem_int *weight; /* [n] nodes in the variable; 0: absorbed, or not a variable; < 0: in the new
                       * element just now */
    sfem_int *degree; /* [n] approximate external degree; of an element, its weight */
    sfem_int *mark;   /* [n] of elements: 0 dead, else compared with the stamp */
    sfem_int *into;   /* [n] variable: the pivot or variable that absorbed it, or -1 */
    sfem_int *head, *next, *prev; /* [n+1], [n], [n] lists of equal degree */
    sfem_int *hash, *bucket;      /* [n] of a variable; [n] hash lists, through next */
} sfemi_amd;

static void sfemi_amd_unlink(sfemi_amd *q, sfem_int i)
{
    const sfem_int before = q->prev[i], after = q->next[i];
    if (before >= 0)
        q->next[before] = after;
    else if (q->head[q->degree[i]] == i)
        q->head[q->degree[i]] = after;
    else
        return; /* not linked: a variable that is not to be eliminated */
    if (after >= 0) q->prev[after] = before;
}

static void sfemi_amd_link(sfemi_amd *q, sfem_int i)
{
    const sfem_int first = q->head[q->degree[i]];
    q->prev[i] = -1;
    q->next[i] = first;
    if (first >= 0) q->prev[first] = i;
    q->head[q->degree[i]] = i;
}

/* Moves the live lists to the front. */
static void sfemi_amd_collect(sfemi_amd *q)
{
    sfem_int i, used = 0, *swap = q->list;
    for (i = 0; i < q->n; ++i) {
        if (!q->weight[i] && !q->mark[i]) continue;
        memcpy(q->spare + used, q->list + q->at[i], (size_t)q->length[i] * sizeof *q->list);
        q->at[i] = used;
        used += q->length[i];
    }
    q->list = q->spare;
    q->spare = swap;
    q->used = used;
}

/* Makes p an element: its list becomes all variables reachable from it; returns their weight. */
static sfem_int sfemi_amd_element(sfemi_amd *q, sfem_int p)
{
    sfem_int e, k, total = 0, count = 0, *out;
    const sfem_int elements = q->elements[p], length = q->length[p];
    if (q->used > q->space - q->n) sfemi_amd_collect(q);
    out = q->list + q->used;
    q->weight[p] = -q->weight[p];
    for (e = 0; e <= elements; ++e) {
        const sfem_int source = e < elements ? q->list[q->at[p] + e] : p;
        const sfem_int *v = q->list + q->at[source] + (e < elements ? 0 : elements);
        const sfem_int *end = q->list + q->at[source] + (e < elements ? q->length[source] : length);
        for (; v < end; ++v) {
            k = *v;
            if (q->weight[k] <= 0) continue;
            total += q->weight[k];
            q->weight[k] = -q->weight[k];
            out[count++] = k;
            sfemi_amd_unlink(q, k);
        }
        if (e < elements) q->mark[source] = 0; /* absorbed */
    }
    q->at[p] = q->used;
    q->length[p] = count;
    q->elements[p] = 0;
    q->used += count;
    return total;
}

/* Are the lists of i and j the same? The stamp marks those of i. */
static int sfemi_amd_same(const sfemi_amd *q, sfem_int i, sfem_int j, const sfem_int *seen,
                          sfem_int stamp)
{
    const sfem_int *v = q->list + q->at[j], *end = v + q->length[j];
    if (q->length[i] != q->length[j] || q->elements[i] != q->elements[j]) return 0;
    for (; v < end; ++v)
        if (seen[*v] != stamp) return 0;
    return 1;
}

/* Orders the nodes that are not held; those are never eliminated, but count in the degrees of
 * others [Pellegrini, Roman, Amestoy 2000]. order gets the others' numbers, its length is returned
 * in *count. */
static sfem_status sfemi_order_amd(const sfemi_graph *g, const unsigned char *held,
                                   const sfem_allocator *m, sfem_int *order, sfem_int *count,
                                   sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfemi_amd q;
    sfem_int *pool = NULL, *seen = NULL, *pivots = NULL;
    const sfem_int n = g->n, nnz = n ? g->start[n] : 0;
    sfem_int i, k, p, live = 0, left = 0, least = 0, stamp = 1, same = 0, made = 0, dense,
                      total = 0;
    memset(&q, 0, sizeof q);
    q.n = n;
    if (nnz > INT32_MAX / 2 - 2 * n)
        return sfemi_fail(err, SFEM_TOO_LARGE, "%ld edges overflow the ordering's index",
                          (long)nnz);
    q.space = nnz + nnz / 4 + 2 * n + 1;
    SFEMI_NEW(sfem_int, q.list, m, q.space);
    SFEMI_NEW(sfem_int, q.spare, m, q.space);
    SFEMI_NEW(sfem_int, pool, m, 14 * (size_t)n + 1);
    q.at = pool;
    q.length = q.at + n;
    q.elements = q.length + n;
    q.weight = q.elements + n;
    q.degree = q.weight + n;
    q.mark = q.degree + n;
    q.into = q.mark + n;
    q.next = q.into + n;
    q.prev = q.next + n;
    q.hash = q.prev + n;
    q.bucket = q.hash + n;
    seen = q.bucket + n;
    pivots = seen + n;
    q.head = pivots + n; /* n+1 */
    for (i = 0; i <= n; ++i) q.head[i] = -1;
    /* nodes of very many neighbours come last and are forgotten meanwhile */
    dense = (sfem_int)(10 * sqrt((double)n));
    if (dense < 40) dense = 40;
    for (i = 0; i < n; ++i) {
        q.into[i] = q.bucket[i] = q.prev[i] = q.next[i] = -1;
        q.weight[i] = g->start[i + 1] - g->start[i] > dense && !(held && held[i]) ? 0 : 1;
        live += q.weight[i];
        if (q.weight[i] && !(held && held[i])) ++left;
    }
    for (i = 0; i < n; ++i) {
        if (!q.weight[i]) continue;
        q.at[i] = q.used;
        for (k = g->start[i]; k < g->start[i + 1]; ++k)
            if (q.weight[g->adj[k]]) q.list[q.used++] = g->adj[k];
        q.length[i] = q.degree[i] = q.used - q.at[i];
        if (!(held && held[i])) sfemi_amd_link(&q, i);
    }
    while (left > 0) {
        sfem_int external, *v, *end, *keep;
        while (q.head[least] < 0) ++least;
        p = q.head[least];
        sfemi_amd_unlink(&q, p);
        external = sfemi_amd_element(&q, p);
        pivots[made++] = p;
        left += q.weight[p]; /* which is negative now */
        live += q.weight[p];
        /* |Le \ Lp| of each element e next to p, as mark[e] - stamp */
        for (v = q.list + q.at[p], end = v + q.length[p]; v < end; ++v) {
            const sfem_int *e = q.list + q.at[*v], *last = e + q.elements[*v];
            for (; e < last; ++e) {
                if (!q.mark[*e]) continue;
                if (q.mark[*e] < stamp) q.mark[*e] = q.degree[*e] + stamp;
                q.mark[*e] += q.weight[*v]; /* negative: less its own */
            }
        }
        /* new lists and degrees of the variables of p */
        for (v = q.list + q.at[p]; v < end; ++v) {
            const sfem_int me = *v, *e = q.list + q.at[me], *last = e + q.elements[me];
            const sfem_int *stop = q.list + q.at[me] + q.length[me];
            const int is_held = held && held[me];
            sfem_int degree = 0, *start = q.list + q.at[me];
            uint32_t hash = 0;
            keep = start;
            for (; e < last; ++e) {
                const sfem_int extra = q.mark[*e] - stamp;
                if (!q.mark[*e]) continue;
                if (extra > 0) {
                    degree += extra;
                    hash += (uint32_t)*e;
                    *keep++ = *e;
                } else
                    q.mark[*e] = 0; /* nothing outside p: absorbed */
            }
            q.elements[me] = (sfem_int)(keep - start) + 1;
            {
                sfem_int *first_variable = keep;
                for (; e < stop; ++e)
                    if (q.weight[*e] > 0) {
                        degree += q.weight[*e];
                        hash += (uint32_t)*e;
                        *keep++ = *e;
                    }
                /* p becomes the first element: the first variable and element make room */
                if (degree == 0 && !is_held) { /* mass elimination: nothing left outside p */
                    const sfem_int w = -q.weight[me];
                    q.weight[p] -= w;
                    external -= w;
                    left -= w;
                    live -= w;
                    q.weight[me] = 0;
                    q.into[me] = p;
                    continue;
                }
                *keep = *first_variable;
                *first_variable = *start;
                *start = p;
                if (first_variable == start) *start = p;
            }
            q.length[me] = (sfem_int)(keep - start) + 1;
            hash += (uint32_t)p;
            if (degree < q.degree[me]) q.degree[me] = degree;
            hash %= (uint32_t)n;
            q.hash[me] = (sfem_int)hash;
            q.next[me] = q.bucket[hash];
            q.bucket[hash] = me;
        }
        q.degree[p] = external;
        q.mark[p] = stamp; /* alive; below every later stamp */
        stamp += n + 1;
        if (stamp > INT32_MAX - 2 * n - 4) {
            stamp = 2;
            for (i = 0; i < n; ++i)
                if (q.mark[i]) q.mark[i] = 1;
        }
        /* variables that look the same become one */
        for (v = q.list + q.at[p]; v < end; ++v) {
            sfem_int b, c, last;
            if (q.weight[*v] >= 0) continue;
            b = q.bucket[q.hash[*v]];
            q.bucket[q.hash[*v]] = -1;
            for (; b >= 0 && q.next[b] >= 0; b = q.next[b]) {
                ++same;
                for (k = 0; k < q.length[b]; ++k) seen[q.list[q.at[b] + k]] = same;
                for (last = b, c = q.next[b]; c >= 0; c = q.next[c]) {
                    if ((!held || held[b] == held[c]) && sfemi_amd_same(&q, b, c, seen, same)) {
                        q.weight[b] += q.weight[c];
                        q.weight[c] = 0;
                        q.into[c] = b;
                        q.next[last] = q.next[c];
                    } else
                        last = c;
                }
            }
        }
        /* back into the degree lists */
        keep = q.list + q.at[p];
        for (v = keep; v < end; ++v) {
            const sfem_int me = *v, w = -q.weight[me];
            sfem_int degree;
            if (w <= 0) continue;
            q.weight[me] = w;
            degree = q.degree[me] + external - w;
            if (degree > live - w) degree = live - w;
            if (degree < 0) degree = 0;
            q.degree[me] = degree;
            q.prev[me] = q.next[me] = -1;
            if (!(held && held[me])) {
                sfemi_amd_link(&q, me);
                if (degree < least) least = degree;
            }
            *keep++ = me;
        }
        q.length[p] = (sfem_int)(keep - (q.list + q.at[p]));
        q.weight[p] = 0;
        if (!q.length[p]) q.mark[p] = 0;
    }
    /* each pivot with all that it absorbed; lists through next, heads in bucket */
    for (i = 0; i < n; ++i) q.bucket[i] = q.next[i] = -1;
    for (i = n - 1; i >= 0; --i) {
        sfem_int root = i;
        if (q.into[i] < 0) continue;
        while (q.into[root] >= 0) root = q.into[root];
        q.next[i] = q.bucket[root];
        q.bucket[root] = i;
    }
    for (k = 0; k < made; ++k) {
        order[total++] = pivots[k];
        for (i = q.bucket[pivots[k]]; i >= 0; i = q.next[i]) order[total++] = i;
    }
    for (i = 0; i < n; ++i)
        if (g->start[i + 1] - g->start[i] > dense && !(held && held[i])) order[total++] = i;
    *count = total;
done:
    sfemi_delete(m, q.list);
    sfemi_delete(m, q.spare);
    sfemi_delete(m, pool);
    return status;
}

/* Nested dissection from the coordinates [George 1973; Miller, Teng, Thurston, Vavasis 1997 for the
 * setting]: a set of nodes is cut by the best of planes in 13 directions, the fewest nodes that
 * cover the cut edges are the separator [Koenig 1931], which is then refined by moving single nodes
 * [Fiduccia, Mattheyses 1982; Ashcraft, Liu 1997 for separators]. */
#define SFEMI_DISSECT_LEAF       200 /* sets this small are left to minimum degree */
#define SFEMI_DISSECT_DIRECTIONS 13
#define SFEMI_DISSECT_WAYS       14 /* and by distance along edges */
#define SFEMI_DISSECT_TRIALS     3  /* of which so many, the cheapest by count, are tried in full */
#define SFEMI_DISSECT_BINS       241

typedef struct sfemi_dissect {
    const sfemi_graph *g;
    const sfem_real *x;
    sfem_int *set;         /* [n] all nodes; a set is a range of it */
    sfem_int *inside;      /* [n] stamp of the set that a node is in, while it is cut */
    sfem_int *mate, *from; /* [n] matching; search tree */
    sfem_int *queue;       /* [3n] of the search; also the log of moves, at most three for a node */
    sfem_int *near[2];     /* [n] of separator nodes: neighbours on either side */
    sfem_int *band;        /* [n] nodes so close to the plane that an edge may be cut */
    float *key;            /* [n] by position in the set */
    signed char *side, *best;        /* [n] by node: 0, 1, or 2 for the separator; 3 for a while */
    float reach[SFEMI_DISSECT_WAYS]; /* longest edge along each direction */
    sfem_int stamp;
} sfemi_dissect;

static const signed char *sfemi_dissect_axis(int direction)
{
    static const signed char axis[SFEMI_DISSECT_DIRECTIONS][3] = {
        {1, 0, 0}, {0, 1, 0},  {0, 0, 1}, {1, 1, 0},  {1, -1, 0}, {1, 0, 1}, {1, 0, -1},
        {0, 1, 1}, {0, 1, -1}, {1, 1, 1}, {1, 1, -1}, {1, -1, 1}, {-1, 1, 1}};
    return axis[direction];
}

static float sfemi_dissect_key(const signed char *axis, const sfem_real *x)
{
    return (float)(axis[0] * x[0] + axis[1] * x[1] + axis[2] * x[2]);
}

static void sfemi_dissect_reach(sfemi_dissect *d)
{
    sfem_int i, e;
    int k;
    for (i = 0; i < d->g->n; ++i)
        for (e = d->g->start[i]; e < d->g->start[i + 1] && d->g->adj[e] < i; ++e) {
            sfem_real u[3];
            sfemi_sub3(d->x + 3 * (size_t)i, d->x + 3 * (size_t)d->g->adj[e], u);
            for (k = 0; k < SFEMI_DISSECT_DIRECTIONS; ++k) {
                const float r = (float)fabs((double)sfemi_dissect_key(sfemi_dissect_axis(k), u));
                if (r > d->reach[k]) d->reach[k] = r;
            }
        }
}

/* mate[] = edges from a node that is far from others, found by two searches; a curled or perforated
 * body is cut better across its length than by a plane. */
static void sfemi_dissect_distance(sfemi_dissect *d, const sfem_int *set, sfem_int m)
{
    sfem_int k, e, start = set[0], pass, head, tail, next;
    for (pass = 0; pass < 2; ++pass) {
        for (k = 0; k < m; ++k) d->mate[set[k]] = -1;
        for (head = tail = 0, next = 0; tail < m;) {
            if (head == tail) { /* another piece goes on where this one ended */
                while (tail > 0 && d->mate[set[next]] >= 0) ++next;
                d->mate[tail > 0 ? set[next] : start] =
                    tail > 0 ? d->mate[d->queue[tail - 1]] + 2 : 0;
                d->queue[tail] = tail > 0 ? set[next] : start;
                ++tail;
            }
            for (; head < tail; ++head) {
                const sfem_int v = d->queue[head];
                for (e = d->g->start[v]; e < d->g->start[v + 1]; ++e) {
                    const sfem_int w = d->g->adj[e];
                    if (d->inside[w] != d->stamp || d->mate[w] >= 0) continue;
                    d->mate[w] = d->mate[v] + 1;
                    d->queue[tail++] = w;
                }
            }
        }
        start = d->queue[m - 1];
    }
}

/* Keys of the set, and the plane that about halves them: keys < cut are side 0. Found from counts
 * in bins, which keep the layers of a lattice together. */
static float sfemi_dissect_plane(sfemi_dissect *d, const sfem_int *set, sfem_int m, int direction)
{
    const signed char *axis = sfemi_dissect_axis(direction % SFEMI_DISSECT_DIRECTIONS);
    sfem_int count[SFEMI_DISSECT_BINS], k, under = 0, b;
    float low = 0, high = 0, scale;
    if (direction == SFEMI_DISSECT_DIRECTIONS) sfemi_dissect_distance(d, set, m);
    for (k = 0; k < m; ++k) {
        const float key = direction == SFEMI_DISSECT_DIRECTIONS
                              ? (float)d->mate[set[k]]
                              : sfemi_dissect_key(axis, d->x + 3 * (size_t)set[k]);
        d->key[k] = key;
        if (k == 0 || key < low) low = key;
        if (k == 0 || key > high) high = key;
    }
    if (!(high > low)) return low;
    low -= (high - low) * 0.00137f; /* no lattice plane at the edge of a bin */
    scale = (SFEMI_DISSECT_BINS - 1) / (high - low);
    memset(count, 0, sizeof count);
    for (k = 0; k < m; ++k) ++count[(int)((d->key[k] - low) * scale)];
    for (b = 0; b < SFEMI_DISSECT_BINS && 2 * (under + count[b]) <= m; ++b) under += count[b];
    /* the median is in bin b: before it or after it, whichever is closer to half */
    if (b < SFEMI_DISSECT_BINS && m - 2 * under > 2 * (under + count[b]) - m) ++b;
    return low + (float)b / scale;
}

/* The band around the plane, with sides; returns the smaller number of nodes that touch the other
 * side, which covers all cut edges, with a penalty for imbalance; -1 if a side is empty. */
static double sfemi_dissect_count(sfemi_dissect *d, const sfem_int *set, sfem_int m, float cut,
                                  float reach, sfem_int *banded)
{
    sfem_int k, e, left = 0, bands = 0, touch[2] = {0, 0};
    const float width = reach * 1.0001f;
    double off;
    for (k = 0; k < m; ++k) {
        const float key = d->key[k] - cut;
        left += key < 0;
        if (key >= width || key < -width) continue;
        d->side[set[k]] = key >= 0;
        d->inside[set[k]] = d->stamp + 1; /* in the set, and in the band */
        d->band[bands++] = set[k];
    }
    *banded = bands;
    for (k = 0; k < bands; ++k) {
        const sfem_int v = d->band[k];
        const signed char s = d->side[v];
        for (e = d->g->start[v]; e < d->g->start[v + 1]; ++e) {
            const sfem_int w = d->g->adj[e];
            if (d->inside[w] == d->stamp + 1 && d->side[w] != s) {
                ++touch[s];
                break;
            }
        }
    }
    for (k = 0; k < bands; ++k) d->inside[d->band[k]] = d->stamp;
    if (!left || left == m) return -1;
    off = (double)(2 * left - m) / m;
    return (touch[0] < touch[1] ? touch[0] : touch[1]) * (1 + 2 * off * off);
}

/* Searches an alternating path from the free node r of side 0 and turns it over. */
static int sfemi_dissect_augment(sfemi_dissect *d, sfem_int r)
{
    sfem_int head = 0, tail = 0, e;
    d->queue[tail++] = r;
    while (head < tail) {
        const sfem_int v = d->queue[head++];
        for (e = d->g->start[v]; e < d->g->start[v + 1]; ++e) {
            sfem_int w = d->g->adj[e];
            if (d->inside[w] != d->stamp || d->side[w] != 1 || d->near[0][w] == r) continue;
            d->near[0][w] = r; /* seen in this search */
            d->from[w] = v;
            if (d->mate[w] >= 0) {
                d->queue[tail++] = d->mate[w];
                continue;
            }
            while (w >= 0) { /* turn the path over */
                const sfem_int u = d->from[w], next = d->mate[u];
                d->mate[w] = u;
                d->mate[u] = w;
                w = next;
            }
            return 1;
        }
    }
    return 0;
}

/* The fewest nodes that cover all edges between the sides become the separator. */
static void sfemi_dissect_cover(sfemi_dissect *d, const sfem_int *set, sfem_int m)
{
    sfem_int k, e, head = 0, tail = 0;
    for (k = 0; k < m; ++k) {
        d->mate[set[k]] = d->from[set[k]] = -1;
        d->near[0][set[k]] = -1;
    }
    for (k = 0; k < m; ++k) { /* greedy first */
        const sfem_int v = set[k];
        if (d->side[v] != 0) continue;
        for (e = d->g->start[v]; e < d->g->start[v + 1]; ++e) {
            const sfem_int w = d->g->adj[e];
            if (d->inside[w] == d->stamp && d->side[w] == 1 && d->mate[w] < 0) {
                d->mate[v] = w;
                d->mate[w] = v;
                break;
            }
        }
    }
    for (k = 0; k < m; ++k)
        if (d->side[set[k]] == 0 && d->mate[set[k]] < 0) sfemi_dissect_augment(d, set[k]);
    /* what alternating paths reach from the free nodes of side 0; near[1] marks it */
    for (k = 0; k < m; ++k) {
        d->near[1][set[k]] = 0;
        if (d->side[set[k]] == 0 && d->mate[set[k]] < 0) {
            d->near[1][set[k]] = 1;
            d->queue[tail++] = set[k];
        }
    }
    while (head < tail) {
        const sfem_int v = d->queue[head++];
        for (e = d->g->start[v]; e < d->g->start[v + 1]; ++e) {
            const sfem_int w = d->g->adj[e];
            if (d->inside[w] != d->stamp || d->side[w] != 1 || d->near[1][w]) continue;
            d->near[1][w] = 1;
            if (!d->near[1][d->mate[w]]) {
                d->near[1][d->mate[w]] = 1;
                d->queue[tail++] = d->mate[w];
            }
        }
    }
    for (k = 0; k < m; ++k) {
        const sfem_int v = set[k];
        if (d->mate[v] >= 0 && d->near[1][v] == (d->side[v] == 1)) d->side[v] = 3;
    }
    for (k = 0; k < m; ++k)
        if (d->side[set[k]] == 3) d->side[set[k]] = 2;
}

static void sfemi_dissect_near(sfemi_dissect *d, sfem_int v)
{
    sfem_int e;
    d->near[0][v] = d->near[1][v] = 0;
    for (e = d->g->start[v]; e < d->g->start[v + 1]; ++e) {
        const sfem_int w = d->g->adj[e];
        if (d->inside[w] == d->stamp && d->side[w] < 2) ++d->near[(int)d->side[w]][v];
    }
}

/* One pass: separator nodes move to a side, which draws their neighbours from the other side into
 * the separator; each node leaves once, and the best state seen is kept. Returns whether it got
 * better. */
static int sfemi_dissect_pass(sfemi_dissect *d, const sfem_int *set, sfem_int m, sfem_int *size)
{
    sfem_int *sep = d->mate, *log = d->queue,
             *seen = d->from; /* seen: left the separator already */
    sfem_int count = 0, k, e, logged = 0, best_logged = 0, best, moves = 0, first, idle = 0;
    const sfem_int limit = (sfem_int)(0.58 * m);
    for (k = 0; k < m; ++k) {
        seen[set[k]] = 0;
        if (d->side[set[k]] == 2) {
            sfemi_dissect_near(d, set[k]);
            sep[count++] = set[k];
        }
    }
    first = best = count;
    while (idle < 30 + first / 8 && moves < 2 * first) {
        sfem_int pick = -1, to = 0, cost = INT32_MAX, v;
        for (k = 0; k < count; ++k) {
            int s;
            if (seen[sep[k]]) continue;
            for (s = 0; s < 2; ++s) {
                const sfem_int c = d->near[1 - s][sep[k]];
                if (size[s] + 1 > limit && size[s] >= size[1 - s]) continue;
                if (c < cost || (c == cost && size[s] < size[to])) {
                    cost = c;
                    pick = k;
                    to = s;
                }
            }
        }
        if (pick < 0) break;
        v = sep[pick];
        sep[pick] = sep[--count];
        seen[v] = 1;
        d->side[v] = (signed char)to;
        log[logged++] = v * 2; /* entered a side; odd: left side for the separator */
        ++size[to];
        ++moves;
        for (e = d->g->start[v]; e < d->g->start[v + 1]; ++e) {
            const sfem_int w = d->g->adj[e];
            sfem_int f;
            if (d->inside[w] != d->stamp) continue;
            if (d->side[w] == 2) ++d->near[to][w];
            if (d->side[w] != 1 - to) continue;
            d->side[w] = 2;
            --size[1 - to];
            log[logged++] = w * 2 + 1;
            sfemi_dissect_near(d, w);
            sep[count++] = w;
            for (f = d->g->start[w]; f < d->g->start[w + 1]; ++f)
                if (d->inside[d->g->adj[f]] == d->stamp && d->side[d->g->adj[f]] == 2)
                    --d->near[1 - to][d->g->adj[f]];
        }
        ++idle;
        if (count < best) {
            best = count;
            best_logged = logged;
            idle = 0;
        }
    }
    while (logged > best_logged) { /* back to the best */
        const sfem_int v = log[--logged] / 2;
        if (log[logged] & 1) { /* it came from the side opposite to the node that drew it */
            sfem_int back = logged;
            while (log[back] & 1) --back;
            d->side[v] = (signed char)(1 - d->side[log[back] / 2]);
            ++size[(int)d->side[v]];
        } else {
            --size[(int)d->side[v]];
            d->side[v] = 2;
        }
    }
    return best < first;
}

/* Cuts set[0..m) in place into side 0, side 1 and separator, of out[] nodes; returns 0 if it
 * cannot. */
static int sfemi_dissect_cut(sfemi_dissect *d, sfem_int *set, sfem_int m, sfem_int *out)
{
    double cost[SFEMI_DISSECT_WAYS], best = -1;
    float cut[SFEMI_DISSECT_WAYS];
    sfem_int k, bands, at[3];
    int i, trial;
    d->stamp += 2;
    for (k = 0; k < m; ++k) d->inside[set[k]] = d->stamp;
    for (i = 0; i < SFEMI_DISSECT_WAYS; ++i) {
        cut[i] = sfemi_dissect_plane(d, set, m, i);
        cost[i] = sfemi_dissect_count(d, set, m, cut[i], d->reach[i], &bands);
    }
    for (trial = 0; trial < SFEMI_DISSECT_TRIALS; ++trial) {
        int pick = -1, pass;
        sfem_int size[3] = {0, 0, 0};
        double off, score;
        for (i = 0; i < SFEMI_DISSECT_WAYS; ++i)
            if (cost[i] >= 0 && (pick < 0 || cost[i] < cost[pick])) pick = i;
        if (pick < 0 || (best >= 0 && cost[pick] > 1.5 * best)) break;
        cost[pick] = -1;
        (void)sfemi_dissect_plane(d, set, m, pick);
        (void)sfemi_dissect_count(d, set, m, cut[pick], d->reach[pick], &bands);
        for (k = 0; k < m; ++k) d->side[set[k]] = d->key[k] >= cut[pick];
        sfemi_dissect_cover(d, d->band, bands);
        for (k = 0; k < m; ++k) ++size[(int)d->side[set[k]]];
        for (pass = 0; pass < 3 && sfemi_dissect_pass(d, set, m, size); ++pass) continue;
        size[2] = m - size[0] - size[1];
        if (!size[0] || !size[1]) continue;
        off = (double)(size[0] - size[1]) / m;
        score = size[2] * (1 + 2 * off * off);
        if (best >= 0 && score >= best) continue;
        best = score;
        for (k = 0; k < m; ++k) d->best[set[k]] = d->side[set[k]];
        memcpy(out, size, sizeof size);
    }
    if (best < 0) return 0;
    at[0] = 0;
    at[1] = out[0];
    at[2] = out[0] + out[1];
    for (k = 0; k < m; ++k) d->queue[at[(int)d->best[set[k]]]++] = set[k];
    memcpy(set, d->queue, (size_t)m * sizeof *set);
    return 1;
}

/* order[new] = old. The interiors of the smallest sets are ordered by minimum degree, all at once.
 */
static sfem_status sfemi_order_dissect(const sfemi_graph *g, const sfem_real *x,
                                       const sfem_allocator *m, sfem_int *order, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfemi_dissect d;
    sfem_int *pool = NULL, *leaf_at = NULL, *leaf = NULL, *amd = NULL;
    signed char *sides = NULL;
    unsigned char *held = NULL;
    sfem_int stack[3 * 64], depth = 0, k, n = g->n, leaves = 0, count = 0;
    memset(&d, 0, sizeof d);
    SFEMI_NEW(sfem_int, pool, m, 12 * (size_t)n + 1);
    SFEMI_NEW(float, d.key, m, (size_t)n + 1);
    SFEMI_NEW(signed char, sides, m, 2 * (size_t)n + 1);
    SFEMI_NEW(unsigned char, held, m, (size_t)n + 1);
    d.g = g;
    d.x = x;
    d.set = order;
    d.inside = pool;
    d.mate = pool + n;
    d.from = d.mate + n;
    d.queue = d.from + n;
    d.near[0] = d.queue + 3 * n;
    d.near[1] = d.near[0] + n;
    d.band = d.near[1] + n;
    leaf_at = d.band + n;
    leaf = leaf_at + n;
    amd = leaf + n;
    d.side = sides;
    d.best = sides + n;
    sfemi_dissect_reach(&d);
    d.reach[SFEMI_DISSECT_DIRECTIONS] = 1;
    for (k = 0; k < n; ++k) order[k] = k;
    stack[depth++] = 0;
    stack[depth++] = n;
    while (depth > 0) {
        const sfem_int last = stack[--depth], first = stack[--depth];
        sfem_int size[3] = {0, 0, 0};
        if (last - first <= SFEMI_DISSECT_LEAF || depth + 4 > 3 * 64 ||
            !sfemi_dissect_cut(&d, order + first, last - first, size)) {
            leaf_at[leaves] = first;
            for (k = first; k < last; ++k) leaf[order[k]] = leaves;
            ++leaves;
            continue;
        }
        for (k = last - size[2]; k < last; ++k) held[order[k]] = 1;
        stack[depth++] = first;
        stack[depth++] = first + size[0];
        stack[depth++] = first + size[0];
        stack[depth++] = last - size[2];
    }
    SFEMI_TRY(sfemi_order_amd(g, held, m, amd, &count, err));
    for (k = 0; k < count; ++k) order[leaf_at[leaf[amd[k]]]++] = amd[k];
done:
    sfemi_delete(m, pool);
    sfemi_delete(m, d.key);
    sfemi_delete(m, sides);
    sfemi_delete(m, held);
    return status;
}

/* --- elimination tree ------------------------------------------------------------------------ */

typedef struct sfemi_tree {
    sfem_int n;
    sfem_int *order;   /* [n] order[new] = old */
    sfem_int *inverse; /* [n] */
    sfem_int *parent;  /* [n] in new numbers, > own, or -1 */
    sfem_int *count;   /* [n] nodes in the column of L, its own included */
    sfem_int *pool;
    double flops;
} sfemi_tree;

/* Numbers the nodes of a forest so that each subtree is contiguous and ends with its root; to[old]
 * = new. head and next are work of [n]. */
static void sfemi_tree_postorder(sfem_int n, const sfem_int *parent, sfem_int *to, sfem_int *head,
                                 sfem_int *next)
{
    sfem_int i, root, made = 0;
    for (i = 0; i < n; ++i) head[i] = -1;
    for (i = n - 1; i >= 0; --i)
        if (parent[i] >= 0) {
            next[i] = head[parent[i]];
            head[parent[i]] = i;
        }
    for (root = 0; root < n; ++root) {
        if (parent[root] >= 0) continue;
        for (i = root;;) { /* down to the first leaf, number, then its sibling or its parent */
            while (head[i] >= 0) {
                const sfem_int child = head[i];
                head[i] = next[child];
                i = child;
            }
            to[i] = made++;
            if (i == root) break;
            i = parent[i];
        }
    }
}

static void sfemi_tree_parents(const sfemi_graph *g, const sfemi_tree *t, sfem_int *parent,
                               sfem_int *above)
{
    sfem_int i, k; /* Liu 1990; above[] is the tree with its paths shortened */
    for (i = 0; i < t->n; ++i) {
        const sfem_int old = t->order[i];
        parent[i] = above[i] = -1;
        for (k = g->start[old]; k < g->start[old + 1]; ++k) {
            sfem_int j = t->inverse[g->adj[k]];
            while (j >= 0 && j < i) {
                const sfem_int next = above[j];
                above[j] = i;
                if (next < 0) parent[j] = i;
                j = next;
            }
        }
    }
}

/* Column counts of L [Gilbert, Ng, Peyton 1994] on a postordered tree; work [4n]. */
static void sfemi_tree_counts(const sfemi_graph *g, sfemi_tree *t, sfem_int *work)
{
    const sfem_int n = t->n;
    sfem_int *first = work, *most = work + n, *previous = work + 2 * n, *above = work + 3 * n;
    sfem_int i, j, k;
    for (j = 0; j < n; ++j) {
        most[j] = previous[j] = first[j] = -1;
        above[j] = j;
    }
    for (j = 0; j < n; ++j) {
        t->count[j] = first[j] < 0;
        if (first[j] < 0) first[j] = j;
        if (t->parent[j] >= 0 && first[t->parent[j]] < 0) first[t->parent[j]] = first[j];
    }
    for (j = 0; j < n; ++j) {
        const sfem_int old = t->order[j];
        if (t->parent[j] >= 0) --t->count[t->parent[j]];
        for (k = g->start[old]; k < g->start[old + 1]; ++k) {
            sfem_int q, r, s;
            i = t->inverse[g->adj[k]];
            if (i <= j || first[j] <= most[i]) continue;
            most[i] = first[j]; /* j is a leaf of the subtree of row i */
            q = previous[i];
            previous[i] = j;
            ++t->count[j];
            if (q < 0) continue;
            for (r = q; above[r] != r; r = above[r]) continue;
            for (; q != r; q = s) {
                s = above[q];
                above[q] = r;
            }
            --t->count[r];
        }
        if (t->parent[j] >= 0) above[j] = t->parent[j];
    }
    t->flops = 0;
    for (j = 0; j < n; ++j) {
        const double c = 3.0 * t->count[j]; /* three columns of c, c - 1, c - 2 */
        if (t->parent[j] >= 0) t->count[t->parent[j]] += t->count[j];
        t->flops += c * c + (c - 1) * (c - 1) + (c - 2) * (c - 2);
    }
}

/* Tree, postorder (which replaces the order given) and counts. */
static sfem_status sfemi_tree_create(const sfemi_graph *g, sfemi_tree *out, const sfem_int *order,
                                     const sfem_allocator *m, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfemi_tree t;
    sfem_int *work = NULL;
    const sfem_int n = g->n;
    sfem_int i;
    memset(&t, 0, sizeof t);
    t.n = n;
    SFEMI_NEW(sfem_int, t.pool, m, 4 * (size_t)n + 1);
    SFEMI_NEW(sfem_int, work, m, 4 * (size_t)n + 1);
    t.order = t.pool;
    t.inverse = t.order + n;
    t.parent = t.inverse + n;
    t.count = t.parent + n;
    for (i = 0; i < n; ++i) {
        t.order[i] = order[i];
        t.inverse[order[i]] = i;
    }
    sfemi_tree_parents(g, &t, t.count, work);
    sfemi_tree_postorder(n, t.count, work, work + n, work + 2 * n);
    for (i = 0; i < n; ++i) t.parent[work[i]] = t.count[i] < 0 ? -1 : work[t.count[i]];
    for (i = 0; i < n; ++i) t.inverse[order[i]] = work[i];
    for (i = 0; i < n; ++i) t.order[t.inverse[i]] = i;
    sfemi_tree_counts(g, &t, work);
    *out = t;
    t.pool = NULL;
done:
    sfemi_delete(m, work);
    sfemi_delete(m, t.pool);
    return status;
}

/* --- counters that threads share ------------------------------------------------------------- */

#if defined(__GNUC__)
#define SFEMI_ATOMICS 1
typedef int32_t sfemi_counter;
#define SFEMI_ATOMIC_ADD(p, v) __atomic_fetch_add((p), (v), __ATOMIC_ACQ_REL) /* the value before  \
                                                                               */
#define SFEMI_ATOMIC_GET(p)    __atomic_load_n((p), __ATOMIC_ACQUIRE)
#define SFEMI_ATOMIC_SET(p, v) __atomic_store_n((p), (v), __ATOMIC_RELEASE)
#elif defined(_MSC_VER)
#define SFEMI_ATOMICS          1
typedef long sfemi_counter;
long _InterlockedExchangeAdd(long volatile *, long);
long _InterlockedExchange(long volatile *, long);
#define SFEMI_ATOMIC_ADD(p, v) _InterlockedExchangeAdd((p), (v))
#define SFEMI_ATOMIC_GET(p)    _InterlockedExchangeAdd((p), 0)
#define SFEMI_ATOMIC_SET(p, v) ((void)_InterlockedExchange((p), (v)))
#else /* no atomics: solvers run on one thread, and factors are made and freed from one */
#define SFEMI_ATOMICS          0
typedef long sfemi_counter;
#define SFEMI_ATOMIC_ADD(p, v) ((*(p) += (v)) - (v))
#define SFEMI_ATOMIC_GET(p)    (*(p))
#define SFEMI_ATOMIC_SET(p, v) ((void)(*(p) = (v)))
#endif

/* Seconds since some moment, or 0 where the language has no such clock. */
static double sfemi_seconds(void)
{
#ifdef _OPENMP
    return omp_get_wtime();
#elif defined(TIME_UTC) && !defined(_WIN32)
    struct timespec t;
    timespec_get(&t, TIME_UTC);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
#else
    return 0;
#endif
}

/* A crew works off a list of units on several threads in one parallel region: each worker takes the
 * next unit, waits for what it depends on, which stands before it in the list and so has been
 * taken, and does it. So one worker alone can do everything, and nobody waits for a thread that the
 * system has not started.
 *
 * On a busy machine several threads may still take longer than one. A pace compares the two: one
 * call in 64 is done alone, and where the crew was slower it rests, for longer each time. */
#define SFEMI_CREW 32 /* most workers */

typedef struct sfemi_pace {
    sfemi_counter calls, rest, longer;
    sfemi_counter alone; /* microseconds / 4 of the latest call on one thread, or 0 */
} sfemi_pace;

typedef struct sfemi_crew {
    void (*unit)(void *data, sfem_int unit);
    void *data;
    sfem_int count;
    sfemi_counter *next;
} sfemi_crew;

static void sfemi_crew_work(void *data, sfem_int worker)
{
    sfemi_crew *c = (sfemi_crew *)data;
    (void)worker;
    for (;;) {
        const sfem_int unit = (sfem_int)SFEMI_ATOMIC_ADD(c->next, 1);
        if (unit >= c->count) return;
        c->unit(c->data, unit);
    }
}

static void sfemi_crew_wait(sfemi_counter *counter, sfem_int value)
{
    int spins = 0;
    while (SFEMI_ATOMIC_GET(counter) < value) {
        if (++spins > 2000) SFEMI_YIELD(); /* who has the unit may need this processor */
#if SFEMI_X86
        else
            __builtin_ia32_pause();
#endif
    }
}

/* Threads to use for the next call. */
static sfem_int sfemi_pace_threads(sfemi_pace *p, const sfem_exec *e)
{
    const sfem_int threads = SFEMI_ATOMICS ? sfemi_threads(e) : 1;
    if (threads == 1) return 1;
    if (SFEMI_ATOMIC_GET(&p->rest) > 0) {
        (void)SFEMI_ATOMIC_ADD(&p->rest, -1);
        return 1;
    }
    if (SFEMI_ATOMIC_ADD(&p->calls, 1) % 64 == 1) return 1;
    return threads < SFEMI_CREW ? threads : SFEMI_CREW;
}

static void sfemi_pace_took(sfemi_pace *p, sfem_int threads, double seconds)
{
    const double units = seconds * 250000 + 1;
    const sfemi_counter took = units < 1e9 ? (sfemi_counter)units : 1000000000;
    const sfemi_counter alone = SFEMI_ATOMIC_GET(&p->alone), longer = SFEMI_ATOMIC_GET(&p->longer);
    if (seconds <= 0) return;
    if (threads == 1)
        SFEMI_ATOMIC_SET(&p->alone, took);
    else if (alone && took > alone) {
        SFEMI_ATOMIC_SET(&p->longer, longer < 8 ? 8 : longer < 512 ? 2 * longer : longer);
        SFEMI_ATOMIC_SET(&p->rest, SFEMI_ATOMIC_GET(&p->longer));
    } else
        SFEMI_ATOMIC_SET(&p->longer, longer / 2);
}

/* --- fronts and kernels ---------------------------------------------------------------------- */

/* The measures of a front of k eliminated and f rows, in tiles of t rows, vectors of w. */
typedef struct sfemi_shape {
    size_t k, f, t, w;
    size_t tiles, diagonal, boundary; /* all; those with pivots; the one that holds row k */
    size_t last;                      /* height of the last tile */
} sfemi_shape;

static sfemi_shape sfemi_shape_of(size_t k, size_t f, size_t w)
{
    sfemi_shape s;
    s.k = k;
    s.f = f;
    s.w = w;
    s.t = 3 * w;
    s.tiles = (f + s.t - 1) / s.t;
    s.diagonal = (k + s.t - 1) / s.t;
    s.boundary = k / s.t;
    s.last = (f - (s.tiles - 1) * s.t + w - 1) / w * w;
    return s;
}

static size_t sfemi_shape_height(const sfemi_shape *s, size_t tile)
{
    return tile + 1 < s->tiles ? s->t : s->last;
}

static size_t sfemi_shape_columns(const sfemi_shape *s, size_t tile) /* of L */
{
    return (tile + 1) * s->t < s->k ? (tile + 1) * s->t : s->k;
}

static size_t sfemi_shape_panel(const sfemi_shape *s, size_t tile) /* where its part of L starts */
{
    const size_t q = s->boundary;
    if (tile <= q) return s->t * s->t * (tile * (tile + 1) / 2);
    return s->t * s->t * (q * (q + 1) / 2) + (tile - q) * s->t * s->k;
}

static size_t sfemi_shape_panel_size(const sfemi_shape *s)
{
    return sfemi_shape_panel(s, s->tiles - 1) + s->last * sfemi_shape_columns(s, s->tiles - 1);
}

static size_t sfemi_shape_update(const sfemi_shape *s, size_t tile) /* where its part of U starts */
{
    const size_t d = tile - s->boundary;
    return s->t * s->t * (d * (d + 1) / 2);
}

static size_t sfemi_shape_update_size(const sfemi_shape *s)
{
    if (s->f == s->k) return 0;
    return sfemi_shape_update(s, s->tiles - 1) +
           s->last * ((s->tiles - 1) * s->t + s->last - s->boundary * s->t);
}

#define SFEMI_BITS 64
#define SFEMI_PATH 0
#include SFEM_SELF
#define SFEMI_BITS 32
#define SFEMI_PATH 0
#include SFEM_SELF
#if SFEMI_X86
#define SFEMI_BITS 64
#define SFEMI_PATH 1
#include SFEM_SELF
#define SFEMI_BITS 32
#define SFEMI_PATH 1
#include SFEM_SELF
#define SFEMI_BITS 64
#define SFEMI_PATH 2
#include SFEM_SELF
#define SFEMI_BITS 32
#define SFEMI_PATH 2
#include SFEM_SELF
#endif

typedef struct sfemi_ldl_kernels {
    const char *name;
    size_t width; /* of a vector of doubles; tiles are three vectors high */
    void (*update)(size_t, size_t, const double *, const double *, size_t, double *, int, int);
    void (*eliminate)(size_t, size_t, const double *, const double *, size_t, double *, int,
                      const double *);
    int (*pivots)(size_t, size_t, double *, int, int, const double *, double *, double *);
    void (*add)(sfem_int, const sfem_int *, size_t, const double *, size_t, double *, size_t);
    void (*dense_minus)(size_t, const double *, size_t, const double *, double *);
    void (*dense_dots)(size_t, const double *, size_t, const double *, double *);
    void (*invert)(size_t, size_t, double *, const double *);
    void (*forward)(size_t, size_t, const double *, double *, const sfem_int *, double *);
    void (*backward)(size_t, size_t, size_t, const double *, double *, const sfem_int *,
                     const double *, double *);
    void (*forward8)(size_t, size_t, const double *, double *, const sfem_int *, double *);
    void (*backward8)(size_t, size_t, size_t, const double *, double *, const sfem_int *,
                      const double *, double *);
    void (*forward4)(size_t, size_t, const double *, double *, const sfem_int *, double *);
    void (*backward4)(size_t, size_t, size_t, const double *, double *, const sfem_int *,
                      const double *, double *);
    void (*invert32)(size_t, size_t, float *, const double *);
    void (*forward32)(size_t, size_t, const float *, float *, const sfem_int *, float *);
    void (*backward32)(size_t, size_t, size_t, const float *, float *, const sfem_int *,
                       const float *, float *);
    void (*forward8_32)(size_t, size_t, const float *, float *, const sfem_int *, float *);
    void (*backward8_32)(size_t, size_t, size_t, const float *, float *, const sfem_int *,
                         const float *, float *);
} sfemi_ldl_kernels;

static const sfemi_ldl_kernels *sfemi_ldl_kernels_of(int path)
{
#define SFEMI_TABLE(name, width, p)                                                                \
    {name, width, sfemi_ldl_update_64_##p, sfemi_ldl_eliminate_64_##p, sfemi_ldl_pivots_64_##p,    \
     sfemi_ldl_add_64_##p, sfemi_dense_minus_64_##p, sfemi_dense_dots_64_##p,                      \
     sfemi_ldl_invert_64_##p, sfemi_ldl_forward_64_##p, sfemi_ldl_backward_64_##p,                 \
     sfemi_ldl_forward8_64_##p, sfemi_ldl_backward8_64_##p, sfemi_ldl_forward4_64_##p,             \
     sfemi_ldl_backward4_64_##p, sfemi_ldl_invert_32_##p,                                          \
     sfemi_ldl_forward_32_##p, sfemi_ldl_backward_32_##p, sfemi_ldl_forward8_32_##p,               \
     sfemi_ldl_backward8_32_##p}
    static const sfemi_ldl_kernels table[] = {
        SFEMI_TABLE("portable", 4, 0),
#if SFEMI_X86
        SFEMI_TABLE("avx2", 4, 1),
        SFEMI_TABLE("avx512", 8, 2),
#endif
    };
#undef SFEMI_TABLE
    return table + path;
}

typedef struct sfemi_eigen_kernels {
    double (*column)(size_t, double *, const double *, const double *, const double *, double *);
    void (*reflect)(size_t, const double *, double, double *);
    void (*sweep)(size_t, size_t, double *, size_t, const double *, const double *);
} sfemi_eigen_kernels;

static const sfemi_eigen_kernels *sfemi_eigen_kernels_of(int path)
{
#define SFEMI_TABLE(p) {sfemi_eigen_column_64_##p, sfemi_eigen_reflect_64_##p, sfemi_eigen_sweep_64_##p}
    static const sfemi_eigen_kernels table[] = {
        SFEMI_TABLE(0),
#if SFEMI_X86
        SFEMI_TABLE(1),
        SFEMI_TABLE(2),
#endif
    };
#undef SFEMI_TABLE
    return table + path;
}

/* --- symbolic analysis ----------------------------------------------------------------------- */

/* What depends on the pattern alone. Supernode s has the columns (nodes) first[s] <= j < first[s+1]
 * in the new numbering and below them the rows rows[start[s]] ... rows[start[s+1] - 1], ascending.
 *
 * Work is cut into tasks, the same for any number of threads: a task is a run of supernodes, either
 * a whole subtree of the elimination tree or one supernode above those. Tasks of equal level do not
 * depend on each other. */
typedef struct sfemi_symbolic {
    sfemi_counter references;
    sfem_allocator allocator;
    const sfemi_ldl_kernels *kernels;
    sfem_int n, blocks, supernodes, tasks, levels;
    sfem_ordering ordering;
    sfem_int *order;     /* [n] order[new] = old */
    sfem_int *inverse;   /* [n] */
    sfem_int *first;     /* [supernodes + 1] */
    size_t *start;       /* [supernodes + 1] */
    sfem_int *rows;      /* [start[supernodes]] */
    sfem_int *place;     /* where in the parent's front each of the rows is, in nodes */
    sfem_int *target;    /* where in the solve's work array each of the rows is, in nodes */
    sfem_int *parent;    /* [supernodes] or -1 */
    sfem_int *child;     /* [supernodes] first child or -1 */
    sfem_int *sibling;   /* [supernodes] next child of the same parent or -1 */
    size_t *panel;       /* [supernodes + 1] where L starts */
    size_t *panel32;     /* [supernodes + 1] where its float copy starts */
    size_t *update;      /* [supernodes] where the update matrix stands in the work memory */
    size_t *update_kept; /* [supernodes + 1] the same, if all are kept */
    size_t *signs;       /* [tasks + 1] where a task's signed copy of a panel stands */
    sfem_int *from;      /* [supernodes + 1] blocks of A that start in the supernode's columns */
    sfem_int *source;    /* [blocks] block of A */
    sfem_int
        *into; /* [blocks][2] row and column in nodes in the front; row < 0: ~row, transposed */
    sfem_int *task;   /* [tasks + 1] first supernode */
    sfem_int *of;     /* [supernodes] task */
    sfem_int *buffer; /* [tasks + 1] where its buffer starts in the solve's work array, in nodes */
    sfem_int *level;  /* [levels + 1] into by_level */
    sfem_int *by_level;                   /* [tasks] */
    sfem_int *at_level;                   /* [tasks] its inverse */
    size_t *scratch;                      /* [tasks + 1] the solve's scratch of a task, in rows */
    size_t update_size, update_kept_size; /* in scalars */
    size_t nnz, bytes;
    double flops;
} sfemi_symbolic;

static sfemi_shape sfemi_symbolic_shape(const sfemi_symbolic *y, sfem_int s, size_t w)
{
    const size_t k = 3 * (size_t)(y->first[s + 1] - y->first[s]);
    return sfemi_shape_of(k, k + 3 * (y->start[s + 1] - y->start[s]), w);
}

static void sfemi_symbolic_free(sfemi_symbolic *y)
{
    sfem_allocator m;
    if (!y || SFEMI_ATOMIC_ADD(&y->references, -1) > 1) return;
    m = y->allocator;
    sfemi_delete(&m, y->order);
    sfemi_delete(&m, y->inverse);
    sfemi_delete(&m, y->first);
    sfemi_delete(&m, y->start);
    sfemi_delete(&m, y->rows);
    sfemi_delete(&m, y->place);
    sfemi_delete(&m, y->target);
    sfemi_delete(&m, y->parent);
    sfemi_delete(&m, y->child);
    sfemi_delete(&m, y->sibling);
    sfemi_delete(&m, y->panel);
    sfemi_delete(&m, y->panel32);
    sfemi_delete(&m, y->update);
    sfemi_delete(&m, y->update_kept);
    sfemi_delete(&m, y->signs);
    sfemi_delete(&m, y->scratch);
    sfemi_delete(&m, y->from);
    sfemi_delete(&m, y->source);
    sfemi_delete(&m, y->into);
    sfemi_delete(&m, y->task);
    sfemi_delete(&m, y->of);
    sfemi_delete(&m, y->buffer);
    sfemi_delete(&m, y->level);
    sfemi_delete(&m, y->by_level);
    sfemi_delete(&m, y->at_level);
    sfemi_delete(&m, y);
}

/* Is it worth a merged supernode of k columns over m rows to hold so many zeros? On small meshes
 * the calls for each supernode dominate, on large ones the memory that the solve reads (measured).
 */
static int sfemi_merge_pays(double k, double m, double zeros, sfem_int n)
{
    static const double limit[3][4] = {/* up to 4, 8, 16 and more columns, in nodes */
                                       {.8, .5, .3, .15},
                                       {.6, .35, .2, .08},
                                       {.4, .15, .08, .03}};
    const double *most = limit[n < 500 ? 0 : n < 2500 ? 1 : 2];
    return zeros / (k * (k + 1) / 2 + k * m) < most[k <= 4 ? 0 : k <= 8 ? 1 : k <= 16 ? 2 : 3];
}

/* Supernodes: columns of equal structure [Ashcraft, Grimes 1989], then children merged into parents
 * where that adds few zeros. Renumbers so that each is contiguous; fills order, inverse, first,
 * parent. */
static sfem_status sfemi_symbolic_supernodes(sfemi_symbolic *y, const sfemi_tree *t,
                                             sfem_error *err)
{
    const sfem_allocator *m = &y->allocator;
    const sfem_int n = t->n;
    sfem_status status = SFEM_OK;
    sfem_int *pool = NULL, *head, *tail, *next, *of, *parent, *width, *below, *child, *sibling, *to;
    double *zeros = NULL;
    sfem_int i, s, count = 0, made = 0, at = 0;
    SFEMI_NEW(sfem_int, pool, m, 10 * (size_t)n + 1);
    SFEMI_NEW(double, zeros, m, (size_t)n + 1);
    head = pool; /* columns of a supernode as a list, until they are numbered */
    tail = head + n;
    next = tail + n;
    of = next + n;
    parent = of + n;
    width = parent + n;
    below = width + n;
    child = below + n;
    sibling = child + n;
    to = sibling + n;
    for (i = 0; i < n; ++i) {
        if (i == 0 || t->parent[i - 1] != i || t->count[i - 1] != t->count[i] + 1) {
            head[count] = i;
            width[count] = 0;
            child[count] = -1;
            ++count;
        } else
            next[tail[count - 1]] = i;
        s = count - 1;
        tail[s] = i;
        next[i] = -1;
        of[i] = s;
        ++width[s];
        below[s] = t->count[i] - 1;
    }
    for (s = count - 1; s >= 0; --s) {
        parent[s] = t->parent[tail[s]] < 0 ? -1 : of[t->parent[tail[s]]];
        if (parent[s] < 0) continue;
        sibling[s] = child[parent[s]];
        child[parent[s]] = s;
    }
    for (s = 0; s < count;
         ++s) { /* children first; merge the one with the least new zeros, repeat */
        for (;;) {
            sfem_int c, before = -1, pick = -1, pick_before = -1;
            double least = 0;
            for (c = child[s]; c >= 0; before = c, c = sibling[c]) {
                const double extra = zeros[c] + (double)width[c] * (width[s] + below[s] - below[c]);
                if (pick >= 0 && extra >= least) continue;
                if (!sfemi_merge_pays(width[c] + width[s], below[s], extra + zeros[s], n)) continue;
                pick = c;
                pick_before = before;
                least = extra;
            }
            if (pick < 0) break;
            zeros[s] += least;
            next[tail[pick]] = head[s];
            head[s] = head[pick];
            width[s] += width[pick];
            width[pick] = 0;
            if (pick_before < 0)
                child[s] = sibling[pick];
            else
                sibling[pick_before] = sibling[pick];
            for (c = child[pick]; c >= 0;) { /* its children become those of s */
                const sfem_int after = sibling[c];
                parent[c] = s;
                sibling[c] = child[s];
                child[s] = c;
                c = after;
            }
        }
    }
    /* number what is left in postorder: merged ones are leaves without columns */
    sfemi_tree_postorder(count, parent, to, of, sibling);
    for (s = 0; s < count; ++s) child[to[s]] = s;
    for (i = 0; i < count; ++i) made += width[child[i]] > 0;
    SFEMI_NEW(sfem_int, y->first, m, (size_t)made + 1);
    SFEMI_NEW(sfem_int, y->parent, m, (size_t)made + 1);
    SFEMI_NEW(sfem_int, y->child, m, (size_t)made + 1);
    SFEMI_NEW(sfem_int, y->sibling, m, (size_t)made + 1);
    SFEMI_NEW(sfem_int, y->order, m, (size_t)n + 1);
    SFEMI_NEW(sfem_int, y->inverse, m, (size_t)n + 1);
    y->supernodes = made;
    for (made = 0, i = 0; i < count; ++i) {
        s = child[i];
        if (!width[s]) continue;
        of[s] = made;
        y->first[made++] = at;
        for (s = head[s]; s >= 0; s = next[s]) {
            y->inverse[t->order[s]] = at;
            y->order[at++] = t->order[s];
        }
    }
    y->first[made] = at;
    for (i = 0; i < count; ++i)
        if (width[child[i]])
            y->parent[of[child[i]]] = parent[child[i]] < 0 ? -1 : of[parent[child[i]]];
    for (s = made; s-- > 0;) y->child[s] = -1;
    for (s = made; s-- > 0;) {
        y->sibling[s] = -1;
        if (y->parent[s] < 0) continue;
        y->sibling[s] = y->child[y->parent[s]];
        y->child[y->parent[s]] = s;
    }
done:
    sfemi_delete(m, pool);
    sfemi_delete(m, zeros);
    return status;
}

/* Sorts few integers: quicksort down to runs of 16, then insertion. */
static void sfemi_sort_int(sfem_int *v, size_t n)
{
    size_t i, j;
    while (n > 16) {
        const sfem_int a = v[0], b = v[n / 2], c = v[n - 1];
        const sfem_int pivot = a < b ? (b < c ? b : a < c ? c : a) : a < c ? a : b < c ? c : b;
        size_t low = 0, high = n - 1;
        for (;; ++low, --high) {
            sfem_int t;
            while (v[low] < pivot) ++low;
            while (v[high] > pivot) --high;
            if (low >= high) break;
            t = v[low];
            v[low] = v[high];
            v[high] = t;
        }
        if (low < n - low) { /* the shorter part by recursion: depth at most log n */
            sfemi_sort_int(v, low);
            v += low;
            n -= low;
        } else {
            sfemi_sort_int(v + low, n - low);
            n = low;
        }
    }
    for (i = 1; i < n; ++i) {
        const sfem_int x = v[i];
        for (j = i; j > 0 && v[j - 1] > x; --j) v[j] = v[j - 1];
        v[j] = x;
    }
}

/* The rows below each supernode: those of A and of its children. */
static sfem_status sfemi_symbolic_rows(sfemi_symbolic *y, const sfemi_graph *g, sfem_error *err)
{
    const sfem_allocator *m = &y->allocator;
    sfem_status status = SFEM_OK;
    sfem_int *mark = NULL, i, s, c, e, k;
    size_t total = 0, room = 0, a;
    SFEMI_NEW(sfem_int, mark, m, (size_t)y->n + 1);
    SFEMI_NEW(size_t, y->start, m, (size_t)y->supernodes + 1);
    room = 4 * (size_t)y->n + 64;
    SFEMI_NEW(sfem_int, y->rows, m, room);
    for (i = 0; i < y->n; ++i) mark[i] = -1;
    for (s = 0; s < y->supernodes; ++s) {
        const sfem_int last = y->first[s + 1];
        const size_t begin = total;
        if (room - total < (size_t)(y->n - last)) { /* at most so many more */
            sfem_int *bigger;
            room = 2 * room + (size_t)y->n;
            SFEMI_NEW(sfem_int, bigger, m, room);
            memcpy(bigger, y->rows, total * sizeof *bigger);
            sfemi_delete(m, y->rows);
            y->rows = bigger;
        }
        for (i = y->first[s]; i < last; ++i) {
            const sfem_int old = y->order[i];
            for (e = g->start[old]; e < g->start[old + 1]; ++e) {
                k = y->inverse[g->adj[e]];
                if (k < last || mark[k] == s) continue;
                mark[k] = s;
                y->rows[total++] = k;
            }
        }
        for (c = y->child[s]; c >= 0; c = y->sibling[c])
            for (a = y->start[c]; a < y->start[c + 1]; ++a) {
                k = y->rows[a];
                if (k < last || mark[k] == s) continue;
                mark[k] = s;
                y->rows[total++] = k;
            }
        sfemi_sort_int(y->rows + begin, total - begin);
        y->start[s + 1] = total;
    }
    SFEMI_NEW(sfem_int, y->place, m, total + 1);
    SFEMI_NEW(sfem_int, y->target, m, total + 1);
    for (s = 0; s < y->supernodes; ++s) {
        const sfem_int p = y->parent[s];
        size_t b;
        if (p < 0) continue;
        b = y->start[p];
        for (a = y->start[s]; a < y->start[s + 1]; ++a) {
            if (y->rows[a] < y->first[p + 1]) {
                y->place[a] = y->rows[a] - y->first[p];
                continue;
            }
            while (y->rows[b] != y->rows[a]) ++b;
            y->place[a] = (sfem_int)(b - y->start[p]) + y->first[p + 1] - y->first[p];
        }
    }
done:
    sfemi_delete(m, mark);
    return status;
}

/* Where each block of A goes. */
static sfem_status sfemi_symbolic_blocks(sfemi_symbolic *y, const sfem_matrix *a, sfem_error *err)
{
    const sfem_allocator *m = &y->allocator;
    sfem_status status = SFEM_OK;
    sfem_int *where = NULL, *of = NULL, i, s, k;
    SFEMI_NEW(sfem_int, of, m, (size_t)y->n + 1);
    SFEMI_NEW(sfem_int, where, m, (size_t)y->n + 1);
    SFEMI_NEW(sfem_int, y->from, m, (size_t)y->supernodes + 2);
    SFEMI_NEW(sfem_int, y->source, m, (size_t)y->blocks + 1);
    SFEMI_NEW(sfem_int, y->into, m, 2 * (size_t)y->blocks + 2);
    for (s = 0; s < y->supernodes; ++s)
        for (i = y->first[s]; i < y->first[s + 1]; ++i) of[i] = s;
#define SFEMI_LOW(i, k)                                                                            \
    (y->inverse[i] < y->inverse[a->col[k]] ? y->inverse[i] : y->inverse[a->col[k]])
    for (i = 0; i < y->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1]; ++k) ++y->from[of[SFEMI_LOW(i, k)] + 2];
    for (s = 0; s < y->supernodes; ++s) y->from[s + 2] += y->from[s + 1];
    for (i = 0; i < y->n; ++i)
        for (k = a->row[i]; k < a->row[i + 1]; ++k) {
            const sfem_int p = y->from[of[SFEMI_LOW(i, k)] + 1]++, col = SFEMI_LOW(i, k);
            const sfem_int row = y->inverse[i] + y->inverse[a->col[k]] - col;
            y->source[p] = k;
            y->into[2 * (size_t)p] = y->inverse[i] < y->inverse[a->col[k]] ? ~row : row;
            y->into[2 * (size_t)p + 1] = col;
        }
#undef SFEMI_LOW
    for (s = 0; s < y->supernodes; ++s) { /* numbers in the front instead of in the matrix */
        const sfem_int width = y->first[s + 1] - y->first[s];
        size_t r;
        for (i = 0; i < width; ++i) where[y->first[s] + i] = i;
        for (r = y->start[s]; r < y->start[s + 1]; ++r)
            where[y->rows[r]] = (sfem_int)(r - y->start[s]) + width;
        for (k = y->from[s]; k < y->from[s + 1]; ++k) {
            sfem_int *into = y->into + 2 * (size_t)k;
            into[0] = into[0] < 0 ? ~where[~into[0]] : where[into[0]];
            into[1] = where[into[1]];
        }
    }
done:
    sfemi_delete(m, of);
    sfemi_delete(m, where);
    return status;
}

/* Cuts the work into tasks of at most a 16th of it and finds the place of every update matrix. */
#define SFEMI_TASK_SHARE 16
#define SFEMI_TASK_LEAST 3e7 /* floating-point operations below which one task does everything */

/* First fit: blocks that live at the same time do not overlap. */
typedef struct sfemi_slot {
    size_t at, size;
    sfem_int until;
} sfemi_slot;

static size_t sfemi_slot_take(sfemi_slot *slot, sfem_int *count, size_t size, sfem_int now,
                              sfem_int until)
{
    sfem_int i, kept = 0;
    size_t at = 0;
    for (i = 0; i < *count; ++i)
        if (slot[i].until >= now) slot[kept++] = slot[i];
    for (i = 0; i < kept && slot[i].at < at + size; ++i) at = slot[i].at + slot[i].size;
    memmove(slot + i + 1, slot + i, (size_t)(kept - i) * sizeof *slot);
    slot[i].at = at;
    slot[i].size = size;
    slot[i].until = until;
    *count = kept + 1;
    return at;
}

static double sfemi_front_flops(const sfemi_symbolic *y, sfem_int s)
{
    const double k = 3.0 * (y->first[s + 1] - y->first[s]);
    const double m = 3.0 * (double)(y->start[s + 1] - y->start[s]);
    return k * (k * k / 3 + k * m + m * m);
}

static sfem_status sfemi_symbolic_tasks(sfemi_symbolic *y, sfem_error *err)
{
    const sfem_allocator *m = &y->allocator;
    const sfem_int ns = y->supernodes;
    sfem_status status = SFEM_OK;
    double *weight = NULL, total = 0, sum = 0;
    sfem_int *level = NULL, s, t, tasks = 0, top = 0;
    SFEMI_NEW(double, weight, m, (size_t)ns + 1);
    SFEMI_NEW(sfem_int, y->of, m, (size_t)ns + 1);
    SFEMI_NEW(sfem_int, y->task, m, (size_t)ns + 1);
    for (s = 0; s < ns; ++s) {
        const double own = sfemi_front_flops(y, s);
        weight[s] += own + 2000; /* the work around a front */
        total += own + 2000;
        if (y->parent[s] >= 0) weight[y->parent[s]] += weight[s];
    }
    if (total < SFEMI_TASK_LEAST) total *= 2 * SFEMI_TASK_SHARE;
    /* A task ends with each supernode that is heavy, or whose parent is; light trees are put
     * together, also with what follows, as they have no rows outside. */
    for (s = 0; s < ns; ++s) {
        const int heavy = weight[s] > total / SFEMI_TASK_SHARE;
        const sfem_int p = y->parent[s];
        y->of[s] = tasks;
        if (p < 0) sum += weight[s];
        if (!heavy && p >= 0 && weight[p] <= total / SFEMI_TASK_SHARE) continue;
        if (!heavy && p < 0 && sum <= total / SFEMI_TASK_SHARE) continue;
        sum = 0;
        y->task[++tasks] = s + 1;
    }
    if (y->task[tasks] < ns) y->task[++tasks] = ns;
    y->tasks = tasks;
    SFEMI_NEW(sfem_int, level, m, (size_t)tasks + 1);
    for (t = 0; t < tasks; ++t) { /* children come before parents */
        const sfem_int p = y->parent[y->task[t + 1] - 1];
        if (level[t] > top) top = level[t];
        if (p >= 0 && level[y->of[p]] <= level[t]) level[y->of[p]] = level[t] + 1;
    }
    y->levels = tasks ? top + 1 : 0;
    SFEMI_NEW(sfem_int, y->level, m, (size_t)y->levels + 3);
    SFEMI_NEW(sfem_int, y->by_level, m, (size_t)tasks + 1);
    SFEMI_NEW(sfem_int, y->at_level, m, (size_t)tasks + 1);
    for (t = 0; t < tasks; ++t) ++y->level[level[t] + 2];
    for (t = 0; t < y->levels; ++t) y->level[t + 2] += y->level[t + 1];
    for (t = 0; t < tasks; ++t) {
        y->at_level[t] = y->level[level[t] + 1]++;
        y->by_level[y->at_level[t]] = t;
    }
done:
    sfemi_delete(m, weight);
    sfemi_delete(m, level);
    return status;
}

/* The places of L, of the update matrices, and of the rows in the solve's work array. */
static sfem_status sfemi_symbolic_layout(sfemi_symbolic *y, sfem_error *err)
{
    const sfem_allocator *m = &y->allocator;
    const sfem_int ns = y->supernodes;
    const size_t w = y->kernels->width;
    sfem_status status = SFEM_OK;
    sfemi_slot *slot = NULL;
    size_t shared = 0, *base = NULL;
    sfem_int s, t, count = 0;
    SFEMI_NEW(sfemi_slot, slot, m, (size_t)ns + 1);
    SFEMI_NEW(size_t, base, m, (size_t)y->tasks + 2);
    SFEMI_NEW(size_t, y->panel, m, (size_t)ns + 1);
    SFEMI_NEW(size_t, y->panel32, m, (size_t)ns + 1);
    SFEMI_NEW(size_t, y->update, m, (size_t)ns + 1);
    SFEMI_NEW(size_t, y->update_kept, m, (size_t)ns + 1);
    SFEMI_NEW(size_t, y->signs, m, (size_t)y->tasks + 1);
    SFEMI_NEW(size_t, y->scratch, m, (size_t)y->tasks + 1);
    SFEMI_NEW(sfem_int, y->buffer, m, (size_t)y->tasks + 1);
    for (t = 0; t < y->tasks; ++t) {
        const sfem_int root = y->task[t + 1] - 1, end = y->first[root + 1];
        size_t widest = 0, signs = 0;
        count = 0;
        for (s = y->task[t]; s <= root; ++s) {
            const sfemi_shape h = sfemi_symbolic_shape(y, s, w),
                              h32 = sfemi_symbolic_shape(y, s, 8);
            const size_t size = sfemi_shape_panel_size(&h), u = sfemi_shape_update_size(&h);
            size_t a, b = y->start[root];
            y->panel[s + 1] = y->panel[s] + size;
            y->panel32[s + 1] = y->panel32[s] + sfemi_shape_panel_size(&h32);
            y->update_kept[s + 1] = y->update_kept[s] + u;
            y->nnz += h.k * (h.k + 1) / 2 + h.k * (h.f - h.k);
            if (size > signs) signs = size;
            if (h.f > widest) widest = h.f;
            for (a = y->start[s]; a < y->start[s + 1]; ++a) {
                if (y->rows[a] < end) {
                    y->target[a] = y->rows[a];
                    continue;
                }
                while (y->rows[b] != y->rows[a]) ++b;
                y->target[a] = y->n + y->buffer[t] + (sfem_int)(b - y->start[root]);
            }
            if (s == root || !u) continue;
            y->update[s] = sfemi_slot_take(slot, &count, u, s, y->parent[s]);
            if (y->update[s] + u > base[t + 1]) base[t + 1] = y->update[s] + u;
        }
        y->signs[t + 1] = y->signs[t] + signs;
        y->scratch[t + 1] = y->scratch[t] + widest + 24;
        if (y->start[root + 1] - y->start[root] > (size_t)(INT32_MAX / 4 - y->n - y->buffer[t])) {
            status = sfemi_fail(err, SFEM_TOO_LARGE, "the solve's work array overflows an index");
            goto done;
        }
        y->buffer[t + 1] = y->buffer[t] + (sfem_int)(y->start[root + 1] - y->start[root]);
    }
    for (t = 0; t < y->tasks;
         ++t) { /* roots of tasks: threads may be anywhere, so nothing is reused */
        const sfem_int root = y->task[t + 1] - 1;
        y->update[root] = shared;
        shared += y->update_kept[root + 1] - y->update_kept[root];
    }
    for (base[0] = shared, t = 0; t < y->tasks; ++t) {
        base[t + 1] += base[t];
        for (s = y->task[t]; s < y->task[t + 1] - 1; ++s) y->update[s] += base[t];
    }
    y->update_size = base[y->tasks];
    y->update_kept_size = y->update_kept[ns];
done:
    sfemi_delete(m, slot);
    sfemi_delete(m, base);
    return status;
}

/* The better of two orderings, or the one asked for. Minimum degree always wins on small meshes,
 * and dissection on large ones unless they are thin, so that one of the two can then be saved
 * (measured). */
#define SFEMI_DISSECT_FROM 1500
#define SFEMI_DISSECT_SURE 4000

static sfem_status sfemi_symbolic_order(const sfem_ldl_def *def, const sfemi_graph *g,
                                        sfem_ordering *taken, sfemi_tree *out, sfem_error *err)
{
    const sfem_allocator *m = &def->allocator;
    sfem_status status = SFEM_OK;
    sfemi_tree best, other;
    sfem_int *order = NULL, i;
    memset(&best, 0, sizeof best);
    memset(&other, 0, sizeof other);
    SFEMI_NEW(sfem_int, order, m, (size_t)g->n + 1);
    *taken = def->ordering;
    if (def->ordering == SFEM_ORDER_NATURAL) {
        for (i = 0; i < g->n; ++i) order[i] = i;
        SFEMI_TRY(sfemi_tree_create(g, &best, order, m, err));
    }
    if (def->ordering == SFEM_ORDER_DISSECTION ||
        (def->ordering == SFEM_ORDER_BEST && def->x && g->n >= SFEMI_DISSECT_FROM)) {
        *taken = SFEM_ORDER_DISSECTION;
        SFEMI_TRY(sfemi_order_dissect(g, def->x, m, order, err));
        SFEMI_TRY(sfemi_tree_create(g, &best, order, m, err));
    }
    if (def->ordering == SFEM_ORDER_AMD ||
        (def->ordering == SFEM_ORDER_BEST &&
         (g->n < SFEMI_DISSECT_SURE || best.flops < 30. * g->n * g->n))) {
        SFEMI_TRY(sfemi_order_amd(g, NULL, m, order, &i, err));
        SFEMI_TRY(sfemi_tree_create(g, &other, order, m, err));
        if (!best.pool || other.flops < best.flops) {
            *taken = SFEM_ORDER_AMD;
            sfemi_delete(m, best.pool);
            best = other;
            other.pool = NULL;
        }
    }
    *out = best;
    best.pool = NULL;
done:
    sfemi_delete(m, order);
    sfemi_delete(m, best.pool);
    sfemi_delete(m, other.pool);
    return status;
}

static sfem_status sfemi_symbolic_create(const sfem_ldl_def *def, const sfem_matrix *a,
                                         sfemi_symbolic **out, sfem_error *err)
{
    const sfem_allocator *m = &def->allocator;
    sfem_status status = SFEM_OK;
    sfemi_symbolic *y = NULL;
    sfemi_graph g = {0, NULL, NULL};
    sfemi_tree tree;
    memset(&tree, 0, sizeof tree);
    if (def->ordering == SFEM_ORDER_DISSECTION && !def->x)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "nested dissection needs coordinates");
    if (def->x && !sfemi_all_finite(def->x, 3 * (size_t)a->n))
        return sfemi_fail(err, SFEM_NOT_FINITE,
                          "a coordinate given for the ordering is not finite");
    SFEMI_NEW(sfemi_symbolic, y, m, 1);
    y->references = 1;
    y->allocator = *m;
    y->kernels = sfemi_ldl_kernels_of(sfemi_path());
    y->n = a->n;
    y->blocks = a->n ? a->row[a->n] : 0;
    SFEMI_TRY(sfemi_graph_create(a, m, &g, err));
    SFEMI_TRY(sfemi_symbolic_order(def, &g, &y->ordering, &tree, err));
    y->flops = tree.flops;
    SFEMI_TRY(sfemi_symbolic_supernodes(y, &tree, err));
    SFEMI_TRY(sfemi_symbolic_rows(y, &g, err));
    SFEMI_TRY(sfemi_symbolic_blocks(y, a, err));
    SFEMI_TRY(sfemi_symbolic_tasks(y, err));
    SFEMI_TRY(sfemi_symbolic_layout(y, err));
    y->bytes = sizeof *y + 8 * (size_t)y->n + 3 * y->start[y->supernodes] * sizeof(sfem_int) +
               12 * (size_t)y->blocks + (size_t)y->supernodes * (5 * sizeof(size_t) + 20) +
               (size_t)y->tasks * 40;
    *out = y;
    y = NULL;
done:
    sfemi_graph_free(m, &g);
    sfemi_delete(m, tree.pool);
    sfemi_symbolic_free(y);
    return status;
}

/* --- the factor and its solves --------------------------------------------------------------- */

struct sfem_ldl {
    sfemi_symbolic *symbolic;
    sfem_allocator allocator;
    sfem_exec exec;
    int positive, mixed, keep, valid;
    double *l;            /* all panels */
    float *l32;           /* the same in float, divided by unit */
    double *update;       /* update matrices */
    double *signs;        /* signed copies of panels, unless positive */
    double *scale;        /* [3n] s / sqrt|d| of each pivot */
    double *floor;        /* [3n] what a pivot must exceed */
    double *lost;         /* [tasks] the pivot that stopped a task */
    sfem_int *lost_at;    /* [tasks] its column, or -1; -2: a task below failed */
    sfem_int *units;      /* [tasks + 1] in order of levels: units of work before each */
    sfemi_counter *done;  /* [tasks + 1] units done; then the crew's counter */
    sfemi_pace *pace;     /* [3] of factorisations, solves, solves of blocks */
    sfem_int *negative;   /* [supernodes] negative pivots */
    unsigned char *stale; /* [supernodes] to be renewed */
    double unit;          /* power of 2 near the root of the largest entry of A */
    double *probe; /* unless positive: for a solve that tells whether the factor is any good */
    double pivot_min, pivot_max, residual;
};

/* --- solve ----------------------------------------------------------------------------------- */

#define SFEMI_SOLVE_BLOCK   8  /* right sides that are solved for together */
#define SFEMI_SOLVE_ALONE   2  /* up to so many are solved for one by one */
#define SFEMI_SOLVE_SCRATCH 16 /* numbers for each row of a task's widest front and right side */

/* work: the unknowns in the new numbering, one buffer for each task with what it adds to rows
 * outside, and scratch for each task; each row of `block` numbers side by side */
typedef struct sfemi_solve {
    const sfem_ldl *ldl;
    size_t block;
    double *w, *scratch;
    float *w32, *scratch32;
    sfem_task forward, backward;
    sfemi_counter *done;
    sfemi_pace *pace;
} sfemi_solve;

static size_t sfemi_solve_rows(const sfemi_symbolic *y)
{
    return 3 * ((size_t)y->n + (size_t)y->buffer[y->tasks]);
}

SFEM_DEF size_t sfem_ldl_work_size(const sfem_ldl *ldl, sfem_int rhs)
{
    const sfemi_symbolic *y = ldl->symbolic;
    return sfemi_solve_rows(y) * (rhs > SFEMI_SOLVE_ALONE ? SFEMI_SOLVE_BLOCK : 1) +
           y->scratch[y->tasks] * SFEMI_SOLVE_SCRATCH + 2 * (size_t)y->tasks + 64;
}

/* The tasks of both sweeps, for double and float. */
#define SFEMI_SOLVE_TASKS(R, forward_task, backward_task, w_, scratch_, l_, panel_, forward_,      \
                          backward_, forward4_, backward4_, forward8_, backward8_)                 \
    static void forward_task(void *data, sfem_int index)                                           \
    {                                                                                              \
        const sfemi_solve *q = (const sfemi_solve *)data;                                          \
        const sfemi_symbolic *y = q->ldl->symbolic;                                                \
        const sfem_int t = index, root = y->task[t + 1] - 1;                                       \
        const size_t n = 3 * q->block; /* numbers to a node */                                     \
        R *const w = q->w_, *const buffer = w + n * ((size_t)y->n + (size_t)y->buffer[t]);         \
        const sfem_int wide = y->first[root + 1] - y->first[root];                                 \
        sfem_int s, c;                                                                             \
        size_t i;                                                                                  \
        memset(buffer, 0, n *(size_t)(y->buffer[t + 1] - y->buffer[t]) * sizeof *buffer);          \
        for (c = y->child[root]; c >= 0; c = y->sibling[c]) { /* what other tasks have to add */   \
            const R *from = w + n * ((size_t)y->n + (size_t)y->buffer[y->of[c]]);                  \
            size_t a = y->start[c];                                                                \
            if (y->of[c] == t) continue;                                                           \
            for (; a < y->start[c + 1]; ++a, from += n) {                                          \
                R *to = y->place[a] < wide ? w + n * (size_t)(y->first[root] + y->place[a])        \
                                           : buffer + n * (size_t)(y->place[a] - wide);            \
                for (i = 0; i < n; ++i) to[i] += from[i];                                          \
            }                                                                                      \
        }                                                                                          \
        for (s = y->task[t]; s <= root; ++s) {                                                     \
            const size_t k = 3 * (size_t)(y->first[s + 1] - y->first[s]);                          \
            const size_t f = k + 3 * (y->start[s + 1] - y->start[s]);                              \
            R *x = w + n * (size_t)y->first[s];                                                    \
            (q->block == 1   ? y->kernels->forward_                                                \
             : q->block == 4 ? y->kernels->forward4_                                               \
                             : y->kernels->forward8_)(                                             \
                k, f, q->ldl->l_ + y->panel_[s], x, y->target + y->start[s], w);                   \
            if (q->ldl->negative[s]) {                                                             \
                const double *scale = q->ldl->scale + 3 * (size_t)y->first[s];                     \
                size_t p;                                                                          \
                for (p = 0; p < k; ++p)                                                            \
                    for (i = 0; i < q->block && scale[p] < 0; ++i)                                 \
                        x[p * q->block + i] = -x[p * q->block + i];                                \
            }                                                                                      \
        }                                                                                          \
    }                                                                                              \
    static void backward_task(void *data, sfem_int index)                                          \
    {                                                                                              \
        const sfemi_solve *q = (const sfemi_solve *)data;                                          \
        const sfemi_symbolic *y = q->ldl->symbolic;                                                \
        const sfem_int t = index, root = y->task[t + 1] - 1, p = y->parent[root];                  \
        const size_t n = 3 * q->block;                                                             \
        R *const w = q->w_, *buffer = w + n * ((size_t)y->n + (size_t)y->buffer[t]);               \
        R *const scratch = q->scratch_ + y->scratch[t] * SFEMI_SOLVE_SCRATCH;                      \
        size_t a;                                                                                  \
        sfem_int s;                                                                                \
        for (a = y->start[root]; a < y->start[root + 1]; ++a, buffer += n) {                       \
            const sfem_int wide = y->first[p + 1] - y->first[p];                                   \
            const sfem_int at = y->place[a] < wide                                                 \
                                    ? y->first[p] + y->place[a]                                    \
                                    : y->n + y->buffer[y->of[p]] + y->place[a] - wide;             \
            memcpy(buffer, w + n * (size_t)at, n * sizeof *buffer);                                \
        }                                                                                          \
        for (s = root; s >= y->task[t]; --s) {                                                     \
            const size_t k = 3 * (size_t)(y->first[s + 1] - y->first[s]);                          \
            const size_t f = k + 3 * (y->start[s + 1] - y->start[s]);                              \
            (q->block == 1   ? y->kernels->backward_                                               \
             : q->block == 4 ? y->kernels->backward4_                                              \
                             : y->kernels->backward8_)(                                            \
                k, f, y->panel_[s + 1] - y->panel_[s], q->ldl->l_ + y->panel_[s],                  \
                w + n * (size_t)y->first[s], y->target + y->start[s], w, scratch);                 \
        }                                                                                          \
    }

SFEMI_SOLVE_TASKS(double, sfemi_solve_forward, sfemi_solve_backward, w, scratch, l, panel, forward,
                  backward, forward4, backward4, forward8, backward8)
SFEMI_SOLVE_TASKS(float, sfemi_solve_forward32, sfemi_solve_backward32, w32, scratch32, l32,
                  panel32, forward32, backward32, forward8_32, backward8_32, forward8_32,
                  backward8_32)
#undef SFEMI_SOLVE_TASKS

/* Unit u of a solve: tasks up the tree by levels, then down again; done[] has one flag for each. */
static void sfemi_solve_unit(void *data, sfem_int u)
{
    const sfemi_solve *q = (const sfemi_solve *)data;
    const sfemi_symbolic *y = q->ldl->symbolic;
    const int up = u < y->tasks;
    const sfem_int t = y->by_level[up ? u : 2 * y->tasks - 1 - u], root = y->task[t + 1] - 1;
    sfem_int c;
    if (up)
        for (c = y->child[root]; c >= 0; c = y->sibling[c]) {
            if (y->of[c] != t) sfemi_crew_wait(q->done + y->of[c], 1);
        }
    else
        sfemi_crew_wait(q->done + (y->parent[root] < 0 ? t : y->tasks + y->of[y->parent[root]]), 1);
    (up ? q->forward : q->backward)(data, t);
    SFEMI_ATOMIC_SET(q->done + (up ? t : y->tasks + t), 1);
}

/* Up the tree and down again. */
#define SFEMI_SOLVE_PARALLEL 400000 /* numbers in L from which a solve is worth several threads */

static void sfemi_solve_sweeps(sfemi_solve *q, const sfem_exec *exec, sfem_task forward,
                               sfem_task backward)
{
    const sfemi_symbolic *y = q->ldl->symbolic;
    const sfem_int threads =
        y->tasks > 1 && y->nnz > SFEMI_SOLVE_PARALLEL ? sfemi_pace_threads(q->pace, exec) : 1;
    const double start = exec && exec->threads > 1 ? sfemi_seconds() : 0;
    sfem_int t;
    if (threads > 1) {
        sfemi_crew crew;
        crew.unit = sfemi_solve_unit;
        crew.data = q;
        crew.count = 2 * y->tasks;
        crew.next = q->done + 2 * y->tasks;
        memset(q->done, 0, (2 * (size_t)y->tasks + 1) * sizeof *q->done);
        q->forward = forward;
        q->backward = backward;
        SFEMI_ATOMIC_SET(crew.next, 0);
        sfemi_run(exec, threads, sfemi_crew_work, &crew);
    } else {
        for (t = 0; t < y->tasks; ++t) forward(q, t);
        for (t = y->tasks; t-- > 0;) backward(q, t);
    }
    if (start > 0) sfemi_pace_took(q->pace, threads, sfemi_seconds() - start);
}

/* count <= block right sides; those that are missing are 0 */
static void sfemi_solve_some(sfemi_solve *q, size_t count, double *x, const sfem_exec *exec)
{
    const sfemi_symbolic *y = q->ldl->symbolic;
    const size_t n = 3 * (size_t)y->n, b = q->block;
    size_t i, r, c;
    if (b == 1) {
        double *w = q->w;
        for (i = 0; i < (size_t)y->n; ++i) {
            const double *from = x + 3 * (size_t)y->order[i];
            w[3 * i] = from[0];
            w[3 * i + 1] = from[1];
            w[3 * i + 2] = from[2];
        }
        sfemi_solve_sweeps(q, exec, sfemi_solve_forward, sfemi_solve_backward);
        for (i = 0; i < (size_t)y->n; ++i) {
            double *to = x + 3 * (size_t)y->order[i];
            to[0] = w[3 * i];
            to[1] = w[3 * i + 1];
            to[2] = w[3 * i + 2];
        }
        return;
    }
    for (i = 0; i < (size_t)y->n; ++i)
        for (c = 0; c < 3; ++c)
            for (r = 0; r < b; ++r)
                q->w[(3 * i + c) * b + r] = r < count ? x[r * n + 3 * (size_t)y->order[i] + c] : 0;
    sfemi_solve_sweeps(q, exec, sfemi_solve_forward, sfemi_solve_backward);
    for (i = 0; i < (size_t)y->n; ++i)
        for (c = 0; c < 3; ++c)
            for (r = 0; r < count; ++r)
                x[r * n + 3 * (size_t)y->order[i] + c] = q->w[(3 * i + c) * b + r];
}

/* The same in float, each right side scaled to 1 lest floats overflow. */
static void sfemi_solve_some32(sfemi_solve *q, size_t count, double *x, const sfem_exec *exec)
{
    const sfemi_symbolic *y = q->ldl->symbolic;
    const size_t n = 3 * (size_t)y->n, b = q->block;
    double unit[SFEMI_SOLVE_BLOCK];
    size_t i, r, c;
    for (r = 0; r < count; ++r) {
        double most = 0;
        int e = 0;
        for (i = 0; i < n; ++i)
            if (fabs(x[r * n + i]) > most) most = fabs(x[r * n + i]);
        if (most > 0) (void)frexp(most, &e);
        unit[r] = ldexp(1.0, -e);
    }
    for (i = 0; i < (size_t)y->n; ++i)
        for (c = 0; c < 3; ++c)
            for (r = 0; r < b; ++r)
                q->w32[(3 * i + c) * b + r] =
                    r < count ? (float)(unit[r] * x[r * n + 3 * (size_t)y->order[i] + c]) : 0;
    sfemi_solve_sweeps(q, exec, sfemi_solve_forward32, sfemi_solve_backward32);
    for (r = 0; r < count; ++r) unit[r] = 1 / unit[r] / q->ldl->unit / q->ldl->unit;
    for (i = 0; i < (size_t)y->n; ++i)
        for (c = 0; c < 3; ++c)
            for (r = 0; r < count; ++r)
                x[r * n + 3 * (size_t)y->order[i] + c] =
                    unit[r] * (double)q->w32[(3 * i + c) * b + r];
}

SFEM_DEF void sfem_ldl_solve(const sfem_ldl *ldl, sfem_int rhs, sfem_real *x, sfem_real *work,
                             const sfem_exec *exec)
{
    const size_t n = 3 * (size_t)ldl->symbolic->n;
    sfemi_solve q;
    SFEM_ASSERT(ldl->valid && rhs >= 0 && (rhs == 0 || n == 0 || (x && work)));
    memset(&q, 0, sizeof q);
    q.ldl = ldl;
    q.block = rhs > SFEMI_SOLVE_ALONE ? SFEMI_SOLVE_BLOCK : 1;
    q.pace = ldl->pace + (q.block == 1 ? 1 : 2);
    q.w = work;
    q.scratch = work + sfemi_solve_rows(ldl->symbolic) * q.block;
    q.w32 = (float *)(void *)q.w;
    q.scratch32 = (float *)(void *)q.scratch;
    q.done = (sfemi_counter *)(void *)(q.scratch + ldl->symbolic->scratch[ldl->symbolic->tasks] *
                                                       SFEMI_SOLVE_SCRATCH);
    while (rhs > 0 && n > 0) {
        const size_t count = (size_t)rhs < q.block ? (size_t)rhs : q.block;
        if (ldl->mixed)
            sfemi_solve_some32(&q, count, x, exec);
        else
            sfemi_solve_some(&q, count, x, exec);
        x += count * n;
        rhs -= (sfem_int)count;
    }
}

/* --- numeric factor -------------------------------------------------------------------------- */

typedef struct sfemi_front {
    const sfem_ldl *ldl;
    const sfem_matrix *a;
    sfem_int s;
    sfemi_shape h;
    double *l, *u, *scale;
    double *b;         /* what stands at the right of products: l, or its signed copy */
    size_t begin, end; /* diagonal tiles of the block of columns at work */
    int load;          /* are there children, so that U starts from what they add? */
} sfemi_front;

static double *sfemi_ldl_update_of(const sfem_ldl *ldl, sfem_int s)
{
    return ldl->update + (ldl->keep ? ldl->symbolic->update_kept[s] : ldl->symbolic->update[s]);
}

/* Clears the front's panel and puts the values of A there. */
static void sfemi_front_begin(sfemi_front *q)
{
    const sfemi_symbolic *y = q->ldl->symbolic;
    const sfemi_shape *h = &q->h;
    const double least = q->ldl->positive ? 4e-15 : 1e-13;
    sfem_int e;
    memset(q->l, 0, sfemi_shape_panel_size(h) * sizeof *q->l);
    if (q->load) memset(q->u, 0, sfemi_shape_update_size(h) * sizeof *q->u);
    for (e = y->from[q->s]; e < y->from[q->s + 1]; ++e) {
        const sfem_int in = y->into[2 * (size_t)e];
        const double *v = q->a->val + 9 * (size_t)y->source[e];
        const size_t row = 3 * (size_t)(in < 0 ? ~in : in),
                     col = 3 * (size_t)y->into[2 * (size_t)e + 1];
        const size_t tile = row / h->t, hd = sfemi_shape_height(h, tile);
        const size_t across = in < 0 ? 3 : 1, down = in < 0 ? 1 : 3;
        double *d = q->l + sfemi_shape_panel(h, tile) + col * hd + (row - tile * h->t);
        int c;
        for (c = 0; c < 3; ++c, d += hd, v += across) {
            d[0] = v[0];
            d[1] = v[down];
            d[2] = v[2 * down];
        }
        if (row == col) {
            double *f = q->ldl->floor + 3 * (size_t)y->first[q->s] + row;
            v = q->a->val + 9 * (size_t)y->source[e];
            for (c = 0; c < 3; ++c) f[c] = least * fabs(v[4 * c]);
        }
    }
}

/* Adds the rows of one tile of a child's update matrix. */
static void sfemi_front_add_tile(const sfemi_front *q, sfem_int child, size_t tile)
{
    const sfemi_symbolic *y = q->ldl->symbolic;
    const sfemi_shape *h = &q->h, ch = sfemi_symbolic_shape(y, child, h->w);
    const sfem_int *place = y->place + y->start[child];
    const sfem_int pivots = y->first[q->s + 1] - y->first[q->s],
                   below = (sfem_int)((ch.f - ch.k) / 3);
    const size_t hs = sfemi_shape_height(&ch, tile);
    const double *src = sfemi_ldl_update_of(q->ldl, child) + sfemi_shape_update(&ch, tile);
    const size_t c0 = ch.boundary * ch.t, d0 = h->boundary * h->t;
    const sfem_int per = (sfem_int)(h->t / 3),
                   shift = (sfem_int)(tile * ch.t / 3) - (sfem_int)(ch.k / 3);
    sfem_int a = shift < 0 ? 0 : shift, last = shift + per < below ? shift + per : below, b, inner;
    for (inner = 0; inner < a && place[inner] < pivots; ++inner) continue;
    while (a < last) {
        const size_t pt = 3 * (size_t)place[a] / h->t, hd = sfemi_shape_height(h, pt);
        double *dl = q->l + sfemi_shape_panel(h, pt) + (3 * (size_t)place[a] - pt * h->t);
        double *du = NULL;
        const double *from = src + (ch.k + 3 * (size_t)a - tile * ch.t) + (ch.k - c0) * hs;
        sfem_int stop = a + 1;
        while (stop < last && place[stop] == place[stop - 1] + 1 &&
               3 * (size_t)place[stop] / h->t == pt)
            ++stop;
        if (place[a] >= pivots || place[stop - 1] >= pivots)
            du = q->u + sfemi_shape_update(h, pt) + (3 * (size_t)place[a] - pt * h->t);
        /* columns left of the run, then its own triangle */
        for (; inner < a && place[inner] < pivots; ++inner) continue;
        y->kernels->add(inner, place, 3 * (size_t)(stop - a), from, hs, dl, hd);
        if (inner < a)
            y->kernels->add(a - inner, place + inner, 3 * (size_t)(stop - a),
                            from + 3 * (size_t)inner * hs, hs, du - d0 * hd, hd);
        for (b = a; b < stop; ++b) {
            const size_t skip = 3 * (size_t)(b - a);
            y->kernels->add(1, place + b, 3 * (size_t)(stop - b), from + 3 * (size_t)b * hs + skip,
                            hs, (place[b] < pivots ? dl : du - d0 * hd) + skip, hd);
        }
        a = stop;
    }
}

/* The columns [begin, end) of diagonal tiles in the rows of one tile below them. */
static void sfemi_front_rows(const sfemi_front *q, size_t tile, size_t end)
{
    const sfemi_ldl_kernels *k = q->ldl->symbolic->kernels;
    const sfemi_shape *h = &q->h;
    const size_t ha = sfemi_shape_height(h, tile);
    double *a = q->l + sfemi_shape_panel(h, tile);
    size_t j, g;
    for (j = q->begin; j < end; ++j) {
        const size_t first = j * h->t, n = sfemi_shape_columns(h, j) - first;
        const double *b = q->b + sfemi_shape_panel(h, j);
        for (g = 0; g < n; g += 4)
            k->eliminate(ha, first + g, a, b + g, sfemi_shape_height(h, j), a + (first + g) * ha,
                         n - g < 4 ? (int)(n - g) : 4, q->scale + first + g);
    }
}

/* Copies columns of a tile with the signs of their pivots. */
static void sfemi_front_sign(const sfemi_front *q, size_t tile, size_t begin, size_t end)
{
    const size_t h = sfemi_shape_height(&q->h, tile), at = sfemi_shape_panel(&q->h, tile);
    size_t c, i;
    for (c = begin; c < end; ++c)
        for (i = 0; i < h; ++i) {
            const double v = q->l[at + c * h + i];
            q->b[at + c * h + i] = q->scale[c] < 0 ? -v : v;
        }
}

/* Factorises one diagonal tile; returns the column whose pivot is lost, or -1. */
static sfem_int sfemi_front_diagonal(const sfemi_front *q, size_t tile, double *lost)
{
    const sfemi_ldl_kernels *k = q->ldl->symbolic->kernels;
    const sfemi_shape *h = &q->h;
    const size_t ha = sfemi_shape_height(h, tile), first = tile * h->t;
    const size_t n = sfemi_shape_columns(h, tile) - first, at = sfemi_shape_panel(h, tile);
    const double *floor = q->ldl->floor + 3 * (size_t)q->ldl->symbolic->first[q->s] + first;
    double *a = q->l + at;
    size_t g;
    if (q->b != q->l) sfemi_front_sign(q, tile, 0, first);
    for (g = 0; g < n; g += 4) {
        const int nq = n - g < 4 ? (int)(n - g) : 4;
        double *c = a + (first + g) * ha;
        int got;
        k->update(ha, first + g, a, q->b + at + g, ha, c, nq, 1);
        got = k->pivots(ha, g, c, nq, q->ldl->positive, floor + g, q->scale + first + g, lost);
        if (got < nq) return (sfem_int)(first + g) + got;
        if (q->b != q->l) sfemi_front_sign(q, tile, first + g, first + g + (size_t)nq);
    }
    return -1;
}

/* U -= L21 S L21^T, four tiles of rows, from the last ones on (they are the longest). */
static void sfemi_front_update(const sfemi_front *q, size_t index)
{
    const sfemi_ldl_kernels *k = q->ldl->symbolic->kernels;
    const sfemi_shape *h = &q->h;
    const size_t last = h->tiles - 4 * index, c0 = h->boundary * h->t;
    const size_t begin = last < h->boundary + 4 ? h->boundary : last - 4;
    size_t tile, j, g;
    for (j = h->boundary; j < last; ++j) {
        const double *b = q->b + sfemi_shape_panel(h, j);
        const size_t hb = sfemi_shape_height(h, j),
                     skip = j == h->boundary ? (h->k - c0) / 4 * 4 : 0;
        for (tile = j > begin ? j : begin; tile < last; ++tile) {
            const size_t ha = sfemi_shape_height(h, tile);
            double *u = q->u + sfemi_shape_update(h, tile) + (j * h->t - c0) * ha;
            for (g = skip; g < hb; g += 4)
                k->update(ha, h->k, q->l + sfemi_shape_panel(h, tile), b + g, hb, u + g * ha, 4,
                          q->load);
        }
    }
}

/* The float copy of a panel, whose tiles are of other height; before the diagonal is inverted. */
static void sfemi_front_copy32(const sfemi_front *q, const sfemi_shape *h32, float *out)
{
    const sfemi_shape *h = &q->h;
    const double unit = 1 / q->ldl->unit;
    size_t tile, p, i;
    for (tile = 0; tile < h32->tiles; ++tile) {
        const size_t hd = sfemi_shape_height(h32, tile), n = sfemi_shape_columns(h32, tile);
        memset(out, 0, hd * n * sizeof *out);
        for (i = 0; i < hd && tile * h32->t + i < h->f;) {
            const size_t row = tile * h32->t + i, from = row / h->t,
                         hs = sfemi_shape_height(h, from);
            const size_t in = row - from * h->t, columns = sfemi_shape_columns(h, from);
            const size_t rows = hs - in < hd - i ? hs - in : hd - i;
            const double *src = q->l + sfemi_shape_panel(h, from) + in;
            size_t r;
            for (p = 0; p < n && p < columns; ++p)
                for (r = 0; r < rows; ++r) out[p * hd + i + r] = (float)(src[p * hs + r] * unit);
            i += rows;
        }
        out += hd * n;
    }
}

/* Diagonal tiles are replaced by their inverses, for the solve. */
static void sfemi_front_finish(const sfemi_front *q)
{
    const sfemi_symbolic *y = q->ldl->symbolic;
    const sfemi_shape *h = &q->h;
    size_t tile;
    q->ldl->negative[q->s] = 0;
    for (tile = 0; tile < h->k; ++tile) q->ldl->negative[q->s] += q->scale[tile] < 0;
    if (q->ldl->mixed) {
        const sfemi_shape h32 = sfemi_symbolic_shape(y, q->s, 8);
        float *l32 = q->ldl->l32 + y->panel32[q->s];
        double scale[24];
        sfemi_front_copy32(q, &h32, l32);
        for (tile = 0; tile < h32.diagonal; ++tile) {
            const size_t first = tile * h32.t, n = sfemi_shape_columns(&h32, tile) - first;
            const size_t hd = sfemi_shape_height(&h32, tile);
            size_t p;
            for (p = 0; p < n; ++p) scale[p] = q->scale[first + p] * q->ldl->unit;
            y->kernels->invert32(hd, n, l32 + sfemi_shape_panel(&h32, tile) + first * hd, scale);
        }
    }
    for (tile = 0; tile < h->diagonal; ++tile) {
        const size_t first = tile * h->t, hd = sfemi_shape_height(h, tile);
        y->kernels->invert(hd, sfemi_shape_columns(h, tile) - first,
                           q->l + sfemi_shape_panel(h, tile) + first * hd, q->scale + first);
    }
}

#define SFEMI_FRONT_PARALLEL 1e7 /* operations from which a front is worth several threads */
#define SFEMI_FRONT_BLOCK    96  /* columns that are eliminated together */
#define SFEMI_FRONT_CHUNK    4   /* tiles of rows to a unit of work */

/* A front is worked off in stages, each of so many units that do not depend on each other:
 * assembly, for each block of columns its diagonal and then the rows below, update, end. */
static size_t sfemi_front_chunks(size_t tiles)
{
    return (tiles + SFEMI_FRONT_CHUNK - 1) / SFEMI_FRONT_CHUNK;
}

/* Children are added in turn; each unit adds a few tiles of one child, at most so many. */
static void sfemi_front_add(const sfemi_front *q, sfem_int child, size_t chunk)
{
    const sfemi_shape h = sfemi_symbolic_shape(q->ldl->symbolic, child, q->h.w);
    size_t tile = h.boundary + chunk * SFEMI_FRONT_CHUNK, last = tile + SFEMI_FRONT_CHUNK;
    for (; h.f > h.k && tile < last && tile < h.tiles; ++tile) sfemi_front_add_tile(q, child, tile);
}

static size_t sfemi_front_add_units(const sfemi_front *q, sfem_int child)
{
    const sfemi_shape h = sfemi_symbolic_shape(q->ldl->symbolic, child, q->h.w);
    return h.f > h.k ? sfemi_front_chunks(h.tiles - h.boundary) : 1;
}

/* The block of columns [begin, end) of diagonal tiles; returns the column that is lost, or -1. */
static sfem_int sfemi_front_block(const sfemi_front *q, double *lost)
{
    size_t tile;
    for (tile = q->begin; tile < q->end; ++tile) {
        sfem_int at;
        sfemi_front_rows(q, tile, tile);
        at = sfemi_front_diagonal(q, tile, lost);
        if (at >= 0) return at;
    }
    return -1;
}

static void sfemi_front_below(const sfemi_front *q, size_t chunk)
{
    size_t tile = q->end + chunk * SFEMI_FRONT_CHUNK, last = tile + SFEMI_FRONT_CHUNK;
    for (; tile < last && tile < q->h.tiles; ++tile) {
        sfemi_front_rows(q, tile, q->end);
        if (q->b != q->l && q->end == q->h.diagonal && tile >= q->h.diagonal)
            sfemi_front_sign(q, tile, 0, q->h.k);
    }
}

/* Does unit number *unit of the front, if it has so many and do_it is set; else subtracts them.
 * Before that, *before is set to the units that have to be done by then. Returns the lost column or
 * -1. */
static sfem_int sfemi_front_unit(sfemi_front *q, size_t unit, int do_it, size_t *before,
                                 double *lost)
{
    const sfemi_symbolic *y = q->ldl->symbolic;
    const size_t block = SFEMI_FRONT_BLOCK / q->h.t;
    sfem_int c;
    size_t n;
    *before = 0;
#define SFEMI_STAGE(count, work)                                                                   \
    n = (count);                                                                                   \
    if (unit < n) {                                                                                \
        if (do_it) {                                                                               \
            work;                                                                                  \
        }                                                                                          \
        return -1;                                                                                 \
    }                                                                                              \
    unit -= n;                                                                                     \
    *before += n;
    SFEMI_STAGE(1, sfemi_front_begin(q))
    for (c = y->child[q->s]; c >= 0; c = y->sibling[c]) {
        SFEMI_STAGE(sfemi_front_add_units(q, c), sfemi_front_add(q, c, unit))
    }
    for (q->begin = 0; q->begin < q->h.diagonal; q->begin = q->end) {
        q->end = q->begin + block < q->h.diagonal ? q->begin + block : q->h.diagonal;
        SFEMI_STAGE(1, return sfemi_front_block(q, lost))
        SFEMI_STAGE(sfemi_front_chunks(q->h.tiles - q->end), sfemi_front_below(q, unit))
    }
    if (q->h.f > q->h.k) {
        SFEMI_STAGE(sfemi_front_chunks(q->h.tiles - q->h.boundary), sfemi_front_update(q, unit))
    }
    SFEMI_STAGE(1, sfemi_front_finish(q))
#undef SFEMI_STAGE
    return -1;
}

static sfemi_front sfemi_front_of(const sfem_ldl *ldl, const sfem_matrix *a, sfem_int s)
{
    const sfemi_symbolic *y = ldl->symbolic;
    sfemi_front q;
    q.ldl = ldl;
    q.a = a;
    q.s = s;
    q.h = sfemi_symbolic_shape(y, s, y->kernels->width);
    q.l = ldl->l + y->panel[s];
    q.u = sfemi_ldl_update_of(ldl, s);
    q.scale = ldl->scale + 3 * (size_t)y->first[s];
    q.b = ldl->positive ? q.l : ldl->signs + y->signs[y->of[s]];
    q.load = y->child[s] >= 0;
    q.begin = q.end = 0;
    return q;
}

/* All of a front at once. Returns the lost column in the new numbering, or -1. */
static sfem_int sfemi_front_factor(const sfem_ldl *ldl, const sfem_matrix *a, sfem_int s,
                                   double *lost)
{
    const sfemi_symbolic *y = ldl->symbolic;
    sfemi_front q = sfemi_front_of(ldl, a, s);
    size_t unit, n, block = SFEMI_FRONT_BLOCK / q.h.t;
    sfem_int c;
    sfemi_front_begin(&q);
    for (c = y->child[s]; c >= 0; c = y->sibling[c])
        for (n = sfemi_front_add_units(&q, c), unit = 0; unit < n; ++unit)
            sfemi_front_add(&q, c, unit);
    for (q.begin = 0; q.begin < q.h.diagonal; q.begin = q.end) {
        q.end = q.begin + block < q.h.diagonal ? q.begin + block : q.h.diagonal;
        c = sfemi_front_block(&q, lost);
        if (c >= 0) return c + 3 * y->first[s];
        for (n = sfemi_front_chunks(q.h.tiles - q.end), unit = 0; unit < n; ++unit)
            sfemi_front_below(&q, unit);
    }
    if (q.h.f > q.h.k)
        for (n = sfemi_front_chunks(q.h.tiles - q.h.boundary), unit = 0; unit < n; ++unit)
            sfemi_front_update(&q, unit);
    sfemi_front_finish(&q);
    return -1;
}

typedef struct sfemi_factor_job {
    sfem_ldl *ldl;
    const sfem_matrix *a;
} sfemi_factor_job;

/* Is the task one front that is worth cutting into units? */
static int sfemi_task_is_cut(const sfemi_symbolic *y, sfem_int t)
{
    return y->task[t + 1] - y->task[t] == 1 &&
           sfemi_front_flops(y, y->task[t]) > SFEMI_FRONT_PARALLEL;
}

static void sfemi_factor_task(const sfem_ldl *ldl, const sfem_matrix *a, sfem_int t)
{
    sfem_int s = ldl->symbolic->task[t];
    for (; s < ldl->symbolic->task[t + 1] && ldl->lost_at[t] == -1; ++s)
        if (ldl->stale[s]) ldl->lost_at[t] = sfemi_front_factor(ldl, a, s, ldl->lost + t);
}

/* Waits for the tasks below t; marks t if one of them failed. */
static void sfemi_factor_wait(const sfem_ldl *ldl, sfem_int t)
{
    const sfemi_symbolic *y = ldl->symbolic;
    sfem_int c = y->child[y->task[t + 1] - 1];
    for (; c >= 0; c = y->sibling[c]) {
        const sfem_int below = y->of[c];
        if (below == t) continue;
        sfemi_crew_wait(ldl->done + below,
                        ldl->units[y->at_level[below] + 1] - ldl->units[y->at_level[below]]);
        if (ldl->lost_at[below] != -1) ldl->lost_at[t] = -2;
    }
}

static void sfemi_factor_unit(void *data, sfem_int unit)
{
    const sfemi_factor_job *job = (const sfemi_factor_job *)data;
    const sfem_ldl *ldl = job->ldl;
    const sfemi_symbolic *y = ldl->symbolic;
    sfem_int low = 0, high = y->tasks, t;
    while (high - low > 1) {
        const sfem_int middle = low + (high - low) / 2;
        if (ldl->units[middle] <= unit)
            low = middle;
        else
            high = middle;
    }
    t = y->by_level[low];
    unit -= ldl->units[low];
    if (unit == 0) sfemi_factor_wait(ldl, t);
    if (!sfemi_task_is_cut(y, t))
        sfemi_factor_task(ldl, job->a, t);
    else if (ldl->stale[y->task[t]]) {
        sfemi_front q = sfemi_front_of(ldl, job->a, y->task[t]);
        size_t before;
        (void)sfemi_front_unit(&q, (size_t)unit, 0, &before, NULL);
        sfemi_crew_wait(ldl->done + t, (sfem_int)before);
        if (ldl->lost_at[t] == -1) {
            const sfem_int at = sfemi_front_unit(&q, (size_t)unit, 1, &before, ldl->lost + t);
            if (at >= 0) ldl->lost_at[t] = at + 3 * y->first[q.s];
        }
    }
    (void)SFEMI_ATOMIC_ADD(ldl->done + t, 1);
}

/* How the work is cut for several threads. */
static void sfemi_factor_units(const sfem_ldl *ldl)
{
    const sfemi_symbolic *y = ldl->symbolic;
    sfem_int k;
    ldl->units[0] = 0;
    for (k = 0; k < y->tasks; ++k) {
        const sfem_int t = y->by_level[k];
        size_t units = 1;
        if (sfemi_task_is_cut(y, t)) {
            sfemi_front q = sfemi_front_of(ldl, NULL, y->task[t]);
            (void)sfemi_front_unit(&q, (size_t)-1, 0, &units, NULL);
        }
        ldl->units[k + 1] = ldl->units[k] + (sfem_int)units;
    }
}

static void sfemi_ldl_statistics(sfem_ldl *ldl)
{
    const size_t n = 3 * (size_t)ldl->symbolic->n;
    double low = 0, high = 0;
    size_t i;
    for (i = 0; i < n; ++i) {
        const double r = fabs(ldl->scale[i]);
        if (i == 0 || r < low) low = r;
        if (r > high) high = r;
    }
    ldl->pivot_min = n ? 1 / (high * high) : 0;
    ldl->pivot_max = n ? 1 / (low * low) : 0;
}

/* Without pivoting, small pivots may have blown L up. One solve shows it: refused above 1e-8. */
static sfem_status sfemi_ldl_try(sfem_ldl *ldl, const sfem_matrix *a, sfem_error *err)
{
    const size_t n = 3 * (size_t)a->n;
    double *x = ldl->probe, *r = x + n, top_a = 0, top_x = 0, top_r = 0;
    size_t i, at = 0;
    sfemi_solve q;
    uint32_t random = 1;
    memset(&q, 0, sizeof q);
    q.ldl = ldl;
    q.block = 1;
    q.pace = ldl->pace + 1;
    q.w = r + n;
    q.scratch = q.w + sfemi_solve_rows(ldl->symbolic);
    q.done = (sfemi_counter *)(void *)(q.scratch + ldl->symbolic->scratch[ldl->symbolic->tasks] *
                                                       SFEMI_SOLVE_SCRATCH);
    for (i = 0; i < n; ++i) {
        random = random * 1664525u + 1013904223u;
        x[i] = (double)(int32_t)random * (1. / 2147483648.);
    }
    sfemi_solve_some(&q, 1, x, &ldl->exec);
    sfem_matrix_multiply(a, x, r, NULL);
    for (i = 0; i < 9 * (size_t)ldl->symbolic->blocks; ++i)
        if (fabs(a->val[i]) > top_a) top_a = fabs(a->val[i]);
    for (random = 1, i = 0; i < n; ++i) {
        random = random * 1664525u + 1013904223u;
        r[i] = fabs(r[i] - (double)(int32_t)random * (1. / 2147483648.));
        if (fabs(x[i]) > top_x) top_x = fabs(x[i]);
        if (r[i] > top_r || !sfemi_finite(r[i])) {
            top_r = r[i];
            at = i;
        }
    }
    ldl->residual = n ? top_r / (top_a * top_x + 1) : 0;
    if (ldl->residual <= 1e-8 && sfemi_finite(top_r)) return SFEM_OK;
    return sfemi_fail_at(
        err, SFEM_SINGULAR, (sfem_int)(at / 3), -1,
        "the matrix is too close to singular or needs pivoting: a trial solve leaves "
        "%g of its right side, most at node %ld",
        top_r, (long)(at / 3));
}

static sfem_status sfemi_ldl_failed(const sfem_ldl *ldl, const sfem_matrix *a, sfem_int task,
                                    sfem_error *err)
{
    const sfem_int node = ldl->symbolic->order[ldl->lost_at[task] / 3];
    const sfem_status status = sfemi_matrix_check_values(a, err);
    if (status != SFEM_OK) return status;
    if (ldl->positive)
        return sfemi_fail_at(
            err, SFEM_NOT_SPD, node, -1,
            "the matrix is not positive definite: pivot %g at node %ld, direction %d",
            ldl->lost[task], (long)node, (int)(ldl->lost_at[task] % 3));
    return sfemi_fail_at(
        err, SFEM_SINGULAR, node, -1,
        "the matrix is singular or needs pivoting: pivot %g at node %ld, direction %d",
        ldl->lost[task], (long)node, (int)(ldl->lost_at[task] % 3));
}

/* Factorises the supernodes that are marked stale. */
static sfem_status sfemi_ldl_factor(sfem_ldl *ldl, const sfem_matrix *a, sfem_error *err)
{
    const sfemi_symbolic *y = ldl->symbolic;
    sfemi_factor_job job;
    sfem_status status = SFEM_OK;
    sfem_int threads, k;
    int e = 0;
    double most = 0, start;
    ldl->valid = 0;
    job.ldl = ldl;
    job.a = a;
    for (k = 0; k < y->n; ++k) {
        const double *v = a->val + 9 * ((size_t)a->row[k + 1] - 1);
        if (fabs(v[0]) > most) most = fabs(v[0]);
    }
    if (most > 0 && sfemi_finite(most)) (void)frexp(sqrt(most), &e);
    if (ldl->mixed && ldl->unit != ldexp(1.0, e)) memset(ldl->stale, 1, (size_t)y->supernodes);
    ldl->unit = ldexp(1.0, e);
    for (k = 0; k < y->tasks; ++k) {
        ldl->lost_at[k] = -1;
        SFEMI_ATOMIC_SET(ldl->done + k, 0);
    }
    threads = y->tasks > 1 ? sfemi_pace_threads(ldl->pace, &ldl->exec) : 1;
    start = ldl->exec.threads > 1 ? sfemi_seconds() : 0;
    if (threads > 1) {
        sfemi_crew crew;
        crew.unit = sfemi_factor_unit;
        crew.data = &job;
        crew.count = ldl->units[y->tasks];
        crew.next = ldl->done + y->tasks;
        SFEMI_ATOMIC_SET(crew.next, 0);
        sfemi_run(&ldl->exec, threads, sfemi_crew_work, &crew);
    } else
        for (k = 0; k < y->tasks && (k == 0 || ldl->lost_at[y->by_level[k - 1]] == -1); ++k)
            sfemi_factor_task(ldl, a, y->by_level[k]);
    if (start > 0) sfemi_pace_took(ldl->pace, threads, sfemi_seconds() - start);
    for (k = 0; k < y->tasks; ++k)
        if (ldl->lost_at[y->by_level[k]] >= 0) return sfemi_ldl_failed(ldl, a, y->by_level[k], err);
    sfemi_ldl_statistics(ldl);
    if (!ldl->positive) status = sfemi_ldl_try(ldl, a, err);
    ldl->valid = status == SFEM_OK;
    return status;
}

#define SFEMI_PANEL_SLACK                                                                          \
    512 /* numbers after L that the block solve may read: half a tile square */

/* The options of like's or def's; takes over one reference to the analysis, also when it fails. */
static sfem_status sfemi_ldl_make(const sfem_ldl *like, sfemi_symbolic *y, const sfem_matrix *a,
                                  sfem_ldl **out, sfem_error *err)
{
    const sfem_allocator *m = &like->allocator;
    sfem_status status = SFEM_OK;
    sfem_ldl *ldl = NULL;
    const size_t n = 3 * (size_t)y->n, ns = (size_t)y->supernodes, nt = (size_t)y->tasks;
    SFEMI_NEW(sfem_ldl, ldl, m, 1);
    ldl->symbolic = y;
    y = NULL;
    ldl->allocator = *m;
    ldl->exec = like->exec;
    ldl->positive = like->positive;
    ldl->mixed = like->mixed;
    ldl->keep = like->keep;
    y = ldl->symbolic;
    SFEMI_NEW(double, ldl->l, m, y->panel[ns] + SFEMI_PANEL_SLACK);
    if (ldl->mixed) SFEMI_NEW(float, ldl->l32, m, y->panel32[ns] + SFEMI_PANEL_SLACK);
    SFEMI_NEW(double, ldl->update, m, (ldl->keep ? y->update_kept_size : y->update_size) + 1);
    if (!ldl->positive) SFEMI_NEW(double, ldl->signs, m, y->signs[nt] + 1);
    if (!ldl->positive) SFEMI_NEW(double, ldl->probe, m, 2 * n + sfem_ldl_work_size(ldl, 1));
    SFEMI_NEW(double, ldl->scale, m, n + 1);
    SFEMI_NEW(double, ldl->floor, m, n + 1);
    SFEMI_NEW(double, ldl->lost, m, nt + 1);
    SFEMI_NEW(sfem_int, ldl->lost_at, m, nt + 1);
    SFEMI_NEW(sfem_int, ldl->units, m, nt + 1);
    SFEMI_NEW(sfemi_counter, ldl->done, m, nt + 1);
    SFEMI_NEW(sfemi_pace, ldl->pace, m, 3);
    SFEMI_NEW(sfem_int, ldl->negative, m, ns + 1);
    SFEMI_NEW(unsigned char, ldl->stale, m, ns + 1);
    memset(ldl->stale, 1, ns);
    sfemi_factor_units(ldl);
    SFEMI_TRY(sfemi_ldl_factor(ldl, a, err));
    *out = ldl;
    return SFEM_OK;
done:
    if (ldl)
        sfem_ldl_free(ldl);
    else
        sfemi_symbolic_free(y);
    return status;
}

SFEM_DEF sfem_ldl_def sfem_default_ldl_def(void)
{
    sfem_ldl_def def;
    memset(&def, 0, sizeof def);
    def.ordering = SFEM_ORDER_BEST;
    def.positive = 1;
    return def;
}

SFEM_DEF sfem_status sfem_ldl_create(const sfem_ldl_def *def, const sfem_matrix *a, sfem_ldl **out,
                                     sfem_error *err)
{
    sfem_status status;
    sfemi_symbolic *y = NULL;
    sfem_ldl like;
    SFEM_ASSERT(def && a && out);
    status = sfemi_matrix_check_pattern(a, err);
    if (status == SFEM_OK) status = sfemi_symbolic_create(def, a, &y, err);
    if (status != SFEM_OK) return status;
    memset(&like, 0, sizeof like);
    like.allocator = def->allocator;
    like.exec = def->exec;
    like.positive = def->positive;
    like.mixed = def->mixed;
    like.keep = def->keep;
    return sfemi_ldl_make(&like, y, a, out, err);
}

static sfem_status sfemi_ldl_matches(const sfem_ldl *ldl, const sfem_matrix *a, sfem_error *err)
{
    const sfem_int blocks = a->n ? a->row[a->n] : 0;
    if (a->n != ldl->symbolic->n || blocks != ldl->symbolic->blocks)
        return sfemi_fail(err, SFEM_MISMATCH,
                          "the matrix has %ld rows and %ld blocks, the factor's had %ld and %ld",
                          (long)a->n, (long)blocks, (long)ldl->symbolic->n,
                          (long)ldl->symbolic->blocks);
    return SFEM_OK;
}

SFEM_DEF sfem_status sfem_ldl_create_like(const sfem_ldl *like, const sfem_matrix *a,
                                          sfem_ldl **out, sfem_error *err)
{
    const sfem_status status = sfemi_ldl_matches(like, a, err);
    if (status != SFEM_OK) return status;
    (void)SFEMI_ATOMIC_ADD(&like->symbolic->references, 1);
    return sfemi_ldl_make(like, like->symbolic, a, out, err);
}

SFEM_DEF sfem_status sfem_ldl_refactor(sfem_ldl *ldl, const sfem_matrix *a, sfem_error *err)
{
    const sfem_status status = sfemi_ldl_matches(ldl, a, err);
    if (status != SFEM_OK) return status;
    memset(ldl->stale, 1, (size_t)ldl->symbolic->supernodes);
    return sfemi_ldl_factor(ldl, a, err);
}

SFEM_DEF sfem_status sfem_ldl_refactor_nodes(sfem_ldl *ldl, const sfem_matrix *a, sfem_int count,
                                             const sfem_int *node, sfem_error *err)
{
    const sfemi_symbolic *y = ldl->symbolic;
    const sfem_status status = sfemi_ldl_matches(ldl, a, err);
    sfem_int i, low, high;
    if (status != SFEM_OK) return status;
    for (i = 0; i < count; ++i)
        if (node[i] < 0 || node[i] >= y->n)
            return sfemi_fail(err, SFEM_BAD_ARGUMENT, "node %ld of %ld", (long)node[i], (long)y->n);
    if (!ldl->keep || !ldl->valid) return sfem_ldl_refactor(ldl, a, err);
    memset(ldl->stale, 0, (size_t)y->supernodes);
    for (i = 0; i < count; ++i) {
        const sfem_int at = y->inverse[node[i]];
        for (low = 0, high = y->supernodes; high - low > 1;) {
            const sfem_int middle = low + (high - low) / 2;
            if (y->first[middle] <= at)
                low = middle;
            else
                high = middle;
        }
        for (; low >= 0 && !ldl->stale[low]; low = y->parent[low]) ldl->stale[low] = 1;
    }
    return sfemi_ldl_factor(ldl, a, err);
}

SFEM_DEF sfem_ldl_info sfem_ldl_get_info(const sfem_ldl *ldl)
{
    const sfemi_symbolic *y = ldl->symbolic;
    const size_t ns = (size_t)y->supernodes, n = 3 * (size_t)y->n;
    sfem_ldl_info info;
    sfem_int s;
    memset(&info, 0, sizeof info);
    info.n = y->n;
    info.supernodes = y->supernodes;
    info.ordering = y->ordering;
    info.nnz = y->nnz;
    info.flops = y->flops;
    info.factor_bytes =
        y->panel[ns] * sizeof(double) + (ldl->mixed ? y->panel32[ns] * sizeof(float) : 0);
    info.analysis_bytes = y->bytes;
    info.work_bytes = (ldl->keep ? y->update_kept_size : y->update_size) * sizeof(double) +
                      2 * n * sizeof(double) + ns * 5 + (size_t)y->tasks * 12 +
                      (ldl->positive ? 0 : y->signs[y->tasks] * sizeof(double));
    info.bytes = info.factor_bytes + info.analysis_bytes + info.work_bytes;
    for (s = 0; s < y->supernodes; ++s) info.negative += ldl->negative[s];
    info.pivot_min = ldl->pivot_min;
    info.pivot_max = ldl->pivot_max;
    info.residual = ldl->residual;
    info.path = y->kernels->name;
    return info;
}

SFEM_DEF void sfem_ldl_free(sfem_ldl *ldl)
{
    sfem_allocator m;
    if (!ldl) return;
    m = ldl->allocator;
    sfemi_symbolic_free(ldl->symbolic);
    sfemi_delete(&m, ldl->l);
    sfemi_delete(&m, ldl->l32);
    sfemi_delete(&m, ldl->update);
    sfemi_delete(&m, ldl->signs);
    sfemi_delete(&m, ldl->probe);
    sfemi_delete(&m, ldl->scale);
    sfemi_delete(&m, ldl->floor);
    sfemi_delete(&m, ldl->lost);
    sfemi_delete(&m, ldl->lost_at);
    sfemi_delete(&m, ldl->units);
    sfemi_delete(&m, ldl->done);
    sfemi_delete(&m, ldl->pace);
    sfemi_delete(&m, ldl->negative);
    sfemi_delete(&m, ldl->stale);
    sfemi_delete(&m, ldl);
}

/* --- dense ----------------------------------------------------------------------------------- */

/* Left-looking by columns, eight at a time: a(j:n, j) -= sum of a(j:n, p) d_p a(j, p); d_p = 1 unless
 * unit, which makes L D L^T. Returns the row of a lost pivot, or -1. */
static sfem_int sfemi_dense_factor(sfem_int n, sfem_real *a, int unit, sfem_int *negative,
                                   double *lost)
{
    const sfemi_ldl_kernels *k = sfemi_ldl_kernels_of(sfemi_path());
    const size_t m = (size_t)n;
    size_t i, j, p, q;
    *negative = 0;
    for (j = 0; j < m; ++j) {
        sfem_real *c = a + j * m, d = fabs(c[j]), w[8];
        const double floor = unit ? 1e-14 * d : 4e-15 * d;
        for (p = 0; p + 8 <= j; p += 8) {
            for (q = 0; q < 8; ++q) w[q] = a[j + (p + q) * m] * (unit ? a[(p + q) * (m + 1)] : 1);
            k->dense_minus(m - j, a + j + p * m, m, w, c + j);
        }
        for (; p < j; ++p) {
            const sfem_real *l = a + p * m, v = unit ? l[j] * l[p] : l[j];
            for (i = j; i < m; ++i) c[i] -= l[i] * v;
        }
        d = c[j];
        if (!((unit ? fabs(d) : d) > floor) || !sfemi_finite(d)) {
            *lost = d;
            return (sfem_int)j;
        }
        *negative += d < 0;
        c[j] = unit ? d : sqrt(d);
        d = 1 / c[j];
        for (i = j + 1; i < m; ++i) c[i] *= d;
    }
    return -1;
}

SFEM_DEF sfem_status sfem_dense_cholesky(sfem_int n, sfem_real *a, sfem_error *err)
{
    double lost = 0;
    sfem_int negative, at;
    SFEM_ASSERT(n >= 0 && (n == 0 || a));
    at = sfemi_dense_factor(n, a, 0, &negative, &lost);
    if (at < 0) return SFEM_OK;
    return sfemi_fail_at(err, sfemi_finite(lost) ? SFEM_NOT_SPD : SFEM_NOT_FINITE, at / 3, -1,
                         "the dense matrix is not positive definite: pivot %g in row %ld", lost,
                         (long)at);
}

SFEM_DEF sfem_status sfem_dense_ldl(sfem_int n, sfem_real *a, sfem_int *negative, sfem_error *err)
{
    double lost = 0;
    sfem_int count, at;
    SFEM_ASSERT(n >= 0 && (n == 0 || a) && negative);
    at = sfemi_dense_factor(n, a, 1, &count, &lost);
    if (at < 0) {
        *negative = count;
        return SFEM_OK;
    }
    return sfemi_fail_at(err, sfemi_finite(lost) ? SFEM_SINGULAR : SFEM_NOT_FINITE, at / 3, -1,
                         "the dense matrix is singular or needs pivoting: pivot %g in row %ld",
                         lost, (long)at);
}

/* x = L^-1 x: eight columns, then what they do to the rows below. */
static void sfemi_dense_forward(sfem_int n, const sfem_real *a, sfem_real *x, int unit)
{
    const sfemi_ldl_kernels *k = sfemi_ldl_kernels_of(sfemi_path());
    const size_t m = (size_t)n;
    size_t i, j, p, end;
    for (j = 0; j < m; j = end) {
        end = j + 8 < m ? j + 8 : m;
        for (p = j; p < end; ++p) {
            if (!unit) x[p] /= a[p * (m + 1)];
            for (i = p + 1; i < end; ++i) x[i] -= a[i + p * m] * x[p];
        }
        if (end < m) k->dense_minus(m - end, a + end + j * m, m, x + j, x + end);
    }
}

/* x = L^-T x: four columns, from the last. */
static void sfemi_dense_backward(sfem_int n, const sfem_real *a, sfem_real *x, int unit)
{
    const sfemi_ldl_kernels *k = sfemi_ldl_kernels_of(sfemi_path());
    const size_t m = (size_t)n;
    size_t i, j, p, end;
    for (end = m; end > 0; end = j) {
        double dot[4] = {0, 0, 0, 0};
        j = end > 4 ? end - 4 : 0;
        if (end - j == 4) k->dense_dots(m - end, a + end + j * m, m, x + end, dot);
        else
            for (p = j; p < end; ++p)
                for (i = end; i < m; ++i) dot[p - j] += a[i + p * m] * x[i];
        for (p = end; p-- > j;) {
            x[p] -= dot[p - j];
            for (i = p + 1; i < end; ++i) x[p] -= a[i + p * m] * x[i];
            if (!unit) x[p] /= a[p * (m + 1)];
        }
    }
}

static void sfemi_dense_solve(sfem_int n, const sfem_real *a, sfem_int rhs, sfem_real *x, int unit)
{
    const size_t m = (size_t)n;
    size_t j;
    for (; rhs > 0; --rhs, x += m) {
        sfemi_dense_forward(n, a, x, unit);
        if (unit)
            for (j = 0; j < m; ++j) x[j] /= a[j * (m + 1)];
        sfemi_dense_backward(n, a, x, unit);
    }
}

SFEM_DEF void sfem_dense_cholesky_solve(sfem_int n, const sfem_real *a, sfem_int rhs, sfem_real *x)
{
    sfemi_dense_solve(n, a, rhs, x, 0);
}

SFEM_DEF void sfem_dense_ldl_solve(sfem_int n, const sfem_real *a, sfem_int rhs, sfem_real *x)
{
    sfemi_dense_solve(n, a, rhs, x, 1);
}

/* --- dense eigenvalues ------------------------------------------------------------------------ */

/* Householder's reduction of the lower half of a to the tridiagonal matrix d, e: a = Q T Q^T, Q = H_0 H_1
 * ..., H_k = I - tau_k v v^T with v in column k below the diagonal, its first entry 1. The matrix is
 * read once a step: each reflection's change is applied while the next product is formed. work: 3 n. */
static void sfemi_eigen_reduce(size_t n, sfem_real *a, sfem_real *d, sfem_real *e, sfem_real *tau,
                               sfem_real *work)
{
    const sfemi_eigen_kernels *f = sfemi_eigen_kernels_of(sfemi_path());
    sfem_real *w = work, *y = work + n, *v = work + 2 * n;
    size_t k, i, j;
    memset(w, 0, n * sizeof *w);
    memset(v, 0, n * sizeof *v);
    for (k = 0; k < n; ++k) { /* w and v hold the last reflection, for the rows from k on */
        sfem_real *u = a + k * n, rest = 0, most = 0, dot = 0, beta, t;
        for (i = k; i < n; ++i) u[i] -= v[i] * w[k] + w[i] * v[k];
        d[k] = u[k];
        e[k] = tau[k] = 0;
        if (k + 1 == n) break;
        for (i = k + 1; i < n; ++i) most = fmax(most, fabs(u[i]));
        beta = most > 0 ? 1 / most : 0;
        for (i = k + 2; i < n; ++i) rest += (u[i] * beta) * (u[i] * beta);
        e[k] = u[k + 1];
        if (rest > 0) {
            beta = most * sqrt(rest + (u[k + 1] / most) * (u[k + 1] / most));
            if (u[k + 1] > 0) beta = -beta;
            t = u[k + 1] - beta;
            tau[k] = -t / beta;
            e[k] = beta;
            for (i = k + 2; i < n; ++i) u[i] /= t;
        }
        u[k + 1] = 1;
        memset(y + k + 1, 0, (n - k - 1) * sizeof *y);
        for (j = k + 1; j < n; ++j) {
            sfem_real *c = a + j * n + j;
            t = f->column(n - j, c, v + j, w + j, u + j, y + j);
            y[j] += t + c[0] * u[j];
        }
        for (i = k + 1; i < n; ++i) dot += (y[i] *= tau[k]) * u[i];
        for (i = k + 1; i < n; ++i) {
            v[i] = u[i];
            w[i] = y[i] - tau[k] / 2 * dot * u[i];
        }
    }
}

/* Writes Q over the reflections that made it. */
static void sfemi_eigen_form(size_t n, sfem_real *a, const sfem_real *tau)
{
    const sfemi_eigen_kernels *f = sfemi_eigen_kernels_of(sfemi_path());
    size_t k, i, j;
    for (k = n - 1; k-- > 0;) /* H_k stands in column k + 1, so that it starts on the diagonal */
        memcpy(a + (k + 1) * n + k + 1, a + k * n + k + 1, (n - k - 1) * sizeof *a);
    for (k = n; k-- > 1;) {
        sfem_real *v = a + k * n;
        for (j = k + 1; j < n; ++j) f->reflect(n - k, v + k, tau[k - 1], a + j * n + k);
        for (i = 0; i < k; ++i) v[i] = 0;
        for (i = k; i < n; ++i) v[i] *= -tau[k - 1];
        v[k] += 1;
    }
    for (i = 0; i < n; ++i) a[i] = i == 0;
}

/* Implicit QL on the tridiagonal matrix with diagonal d and e beside it; its rotations are applied to
 * the columns of z [n][h], of which the first `rows` numbers are used. work: 2 n. Returns 0 if an
 * eigenvalue does not come out. */
static int sfemi_eigen_ql(size_t n, sfem_real *d, sfem_real *e, size_t rows, sfem_real *z, size_t h,
                          sfem_real *work)
{
    const sfemi_eigen_kernels *f = sfemi_eigen_kernels_of(sfemi_path());
    sfem_real *cosine = work, *sine = work + n;
    size_t l, m, i;
    int turns;
    if (n > 0) e[n - 1] = 0;
    for (l = 0; l < n; ++l)
        for (turns = 0;; ++turns) {
            sfem_real g, r, s = 1, c = 1, p = 0;
            for (m = l; m + 1 < n; ++m) {
                const sfem_real size = fabs(d[m]) + fabs(d[m + 1]);
                if (fabs(e[m]) <= 1.2e-16 * size + 1e-280) break;
            }
            if (m == l) break;
            if (turns == 80) return 0;
            g = (d[l + 1] - d[l]) / (2 * e[l]);
            r = hypot(g, 1.0);
            g = d[m] - d[l] + e[l] / (g + (g < 0 ? -r : r));
            for (i = m; i > l; --i) {
                const sfem_real b = c * e[i - 1];
                sfem_real t = s * e[i - 1];
                e[i] = r = sqrt(t * t + g * g);
                if (!(r > 1e-290)) break; /* underflow: the matrix falls apart here */
                s = t / r;
                c = g / r;
                g = d[i] - p;
                t = (d[i - 1] - g) * s + 2 * c * b;
                d[i] = g + (p = s * t);
                g = c * t - b;
                cosine[i - 1] = c;
                sine[i - 1] = s;
            }
            if (rows && m > i) f->sweep(rows, m - i, z + i * h, h, cosine + i, sine + i);
            if (i > l) {
                d[i] -= p;
                e[m] = 0;
                continue;
            }
            d[l] -= p;
            e[l] = g;
            e[m] = 0;
        }
    return 1;
}

/* Ascending, the columns of z with them. */
static void sfemi_eigen_sort(size_t n, sfem_real *d, size_t rows, sfem_real *z, size_t h)
{
    size_t i, j, k;
    for (i = 0; i + 1 < n; ++i) {
        sfem_real t;
        for (k = i, j = i + 1; j < n; ++j)
            if (d[j] < d[k]) k = j;
        if (k == i) continue;
        t = d[i];
        d[i] = d[k];
        d[k] = t;
        for (j = 0; j < rows; ++j) {
            t = z[i * h + j];
            z[i * h + j] = z[k * h + j];
            z[k * h + j] = t;
        }
    }
}

/* A = L^-1 A L^-T, all of it, from its lower half. */
static void sfemi_eigen_standard(size_t n, sfem_real *a, const sfem_real *l)
{
    size_t i, j, turn;
    for (j = 0; j < n; ++j)
        for (i = j + 1; i < n; ++i) a[j + i * n] = a[i + j * n];
    for (turn = 0; turn < 2; ++turn) {
        for (j = 0; j < n; ++j) sfemi_dense_forward((sfem_int)n, l, a + j * n, 0);
        for (j = 0; j < n; ++j)
            for (i = j + 1; i < n; ++i) {
                const sfem_real t = a[j + i * n];
                a[j + i * n] = a[i + j * n];
                a[i + j * n] = t;
            }
    }
}

SFEM_DEF sfem_status sfem_dense_eigen(sfem_int n, sfem_real *a, sfem_real *b, sfem_real *lambda,
                                      sfem_real *work, sfem_error *err)
{
    const size_t m = (size_t)n;
    sfem_real most = 0, scale;
    sfem_status status;
    size_t i, j;
    int e = 0;
    SFEM_ASSERT(n >= 0 && (n == 0 || (a && lambda && work)));
    if (n == 0) return SFEM_OK;
    if (b) {
        status = sfem_dense_cholesky(n, b, err);
        if (status != SFEM_OK) return status;
        sfemi_eigen_standard(m, a, b);
    }
    for (j = 0; j < m; ++j)
        for (i = j; i < m; ++i) {
            if (!sfemi_finite(a[i + j * m]))
                return sfemi_fail_at(err, SFEM_NOT_FINITE, (sfem_int)(i / 3), -1,
                                     "row %ld, column %ld of the dense matrix is not finite", (long)i,
                                     (long)j);
            most = fmax(most, fabs(a[i + j * m]));
        }
    if (most > 0) (void)frexp(most, &e);
    scale = ldexp(1.0, -e);
    for (i = 0; i < m * m; ++i) a[i] *= scale;
    sfemi_eigen_reduce(m, a, lambda, work, work + m, work + 2 * m);
    sfemi_eigen_form(m, a, work + m);
    if (!sfemi_eigen_ql(m, lambda, work, m, a, m, work + 2 * m))
        return sfemi_fail(err, SFEM_NOT_CONVERGED, "an eigenvalue of a dense matrix of %ld rows does not "
                          "converge", (long)n);
    sfemi_eigen_sort(m, lambda, m, a, m);
    for (i = 0; i < m; ++i) lambda[i] = ldexp(lambda[i], e);
    for (j = 0; b && j < m; ++j) sfemi_dense_backward(n, b, a + j * m, 0);
    return SFEM_OK;
}

/* --- conjugate gradients --------------------------------------------------------------------- */

SFEM_DEF sfem_cg_def sfem_default_cg_def(void)
{
    sfem_cg_def def;
    memset(&def, 0, sizeof def);
    def.tolerance = 1e-8;
    return def;
}

SFEM_DEF size_t sfem_cg_work_size(const sfem_cg_def *def, const sfem_matrix *a)
{
    return 13 * (size_t)a->n +
           (def->preconditioner ? sfem_ldl_work_size(def->preconditioner, 1) : 9 * (size_t)a->n) +
           8;
}

/* Inverse of a symmetric positive definite 3x3 block, of which the lower half is read; 0 if it is
 * not. */
static int sfemi_block_invert(const sfem_real *b, sfem_real *out)
{
    const sfem_real c0 = b[4] * b[8] - b[7] * b[7], c1 = b[6] * b[7] - b[3] * b[8];
    const sfem_real c2 = b[3] * b[7] - b[4] * b[6], det = b[0] * c0 + b[3] * c1 + b[6] * c2;
    if (!(b[0] > 0) || !(b[0] * b[4] - b[3] * b[3] > 0) || !(det > 0) || !sfemi_finite(det))
        return 0;
    out[0] = c0 / det;
    out[1] = out[3] = c1 / det;
    out[2] = out[6] = c2 / det;
    out[4] = (b[0] * b[8] - b[6] * b[6]) / det;
    out[5] = out[7] = (b[3] * b[6] - b[0] * b[7]) / det;
    out[8] = (b[0] * b[4] - b[3] * b[3]) / det;
    return 1;
}

static sfem_real sfemi_dot(size_t n, const sfem_real *a, const sfem_real *b)
{
    sfem_real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
    size_t i;
    for (i = 0; i + 4 <= n; i += 4) {
        s0 += a[i] * b[i];
        s1 += a[i + 1] * b[i + 1];
        s2 += a[i + 2] * b[i + 2];
        s3 += a[i + 3] * b[i + 3];
    }
    for (; i < n; ++i) s0 += a[i] * b[i];
    return (s0 + s1) + (s2 + s3);
}

typedef struct sfemi_cg {
    const sfem_cg_def *def;
    const sfem_matrix *a;
    size_t n;
    sfem_real *r, *p, *z, *inverse, *work; /* inverse: the diagonal blocks */
} sfemi_cg;

static void sfemi_cg_precondition(const sfemi_cg *c)
{
    size_t i;
    if (c->def->preconditioner) {
        memcpy(c->z, c->r, c->n * sizeof *c->z);
        sfem_ldl_solve(c->def->preconditioner, 1, c->z, c->work, &c->def->exec);
        return;
    }
    memset(c->z, 0, c->n * sizeof *c->z);
    for (i = 0; i < c->n / 3; ++i)
        sfemi_block_times(c->inverse + 9 * i, c->r + 3 * i, c->z + 3 * i);
}

SFEM_DEF sfem_status sfem_cg_solve(const sfem_cg_def *def, const sfem_matrix *a, const sfem_real *b,
                                   sfem_real *x, sfem_real *work, sfem_cg_info *info,
                                   sfem_error *err)
{
    sfemi_cg c;
    sfem_int it = 0, node;
    sfem_real rz = 0, norm, goal, *ap;
    const sfem_int limit = def->max_iterations > 0 ? def->max_iterations : 3 * a->n;
    size_t i;
    int restarted = 0;
    c.def = def;
    c.a = a;
    c.n = 3 * (size_t)a->n;
    c.r = work;
    c.p = c.r + c.n;
    c.z = c.p + c.n;
    ap = c.z + c.n;
    c.inverse = c.work = ap + c.n;
    if (def->preconditioner && def->preconditioner->symbolic->n != a->n)
        return sfemi_fail(err, SFEM_MISMATCH, "the preconditioner has %ld rows, the matrix %ld",
                          (long)def->preconditioner->symbolic->n, (long)a->n);
    if (!def->preconditioner)
        for (node = 0; node < a->n; ++node)
            if (!sfemi_block_invert(a->val + 9 * ((size_t)a->row[node + 1] - 1),
                                    c.inverse + 9 * (size_t)node)) {
                const sfem_status status = sfemi_matrix_check_values(a, err);
                return status != SFEM_OK
                           ? status
                           : sfemi_fail_at(err, SFEM_NOT_SPD, node, -1,
                                           "the diagonal block of node %ld is not positive "
                                           "definite",
                                           (long)node);
            }
    norm = sqrt(sfemi_dot(c.n, b, b));
    sfem_matrix_multiply(a, x, c.r, &def->exec);
    for (i = 0; i < c.n; ++i) c.r[i] = b[i] - c.r[i];
    if (!sfemi_finite(norm) || !sfemi_finite(sfemi_dot(c.n, c.r, c.r)))
        return sfemi_fail(err, SFEM_NOT_FINITE,
                          "the right side, the start or the matrix is not finite");
    goal = def->tolerance * norm;
    for (;;) {
        sfem_real rr = sqrt(sfemi_dot(c.n, c.r, c.r)), pap, alpha, next;
        if (rr <= goal || it >= limit) {
            /* the recurrence drifts from b - A x: check, and go on from the truth once */
            sfem_matrix_multiply(a, x, ap, &def->exec);
            for (i = 0; i < c.n; ++i) c.r[i] = b[i] - ap[i];
            rr = sqrt(sfemi_dot(c.n, c.r, c.r));
            if (rr <= goal || it >= limit || restarted++ > 2) {
                if (info) {
                    info->iterations = it;
                    info->residual = norm > 0 ? rr / norm : rr;
                    info->converged = rr <= goal;
                }
                return rr <= goal
                           ? SFEM_OK
                           : sfemi_fail(err, SFEM_NOT_CONVERGED,
                                        "conjugate gradients: %ld iterations, residual %g of %g",
                                        (long)it, rr / (norm > 0 ? norm : 1), def->tolerance);
            }
            rz = 0;
        }
        sfemi_cg_precondition(&c);
        next = sfemi_dot(c.n, c.r, c.z);
        if (rz > 0) {
            const sfem_real beta = next / rz;
            for (i = 0; i < c.n; ++i) c.p[i] = c.z[i] + beta * c.p[i];
        } else
            memcpy(c.p, c.z, c.n * sizeof *c.p);
        rz = next;
        sfem_matrix_multiply(a, c.p, ap, &def->exec);
        pap = sfemi_dot(c.n, c.p, ap);
        if (!sfemi_finite(pap))
            return sfemi_fail(err, SFEM_NOT_FINITE, "conjugate gradients: a number is not finite");
        if (!(pap > 0) || !(rz > 0))
            return sfemi_fail(err, SFEM_NOT_SPD,
                              "conjugate gradients: curvature %g in iteration %ld", pap, (long)it);
        alpha = rz / pap;
        for (i = 0; i < c.n; ++i) {
            x[i] += alpha * c.p[i];
            c.r[i] -= alpha * ap[i];
        }
        ++it;
    }
}

/* ============================================================================================
 * >>element   linear, corotational, StVK, neo-Hookean tetrahedron; edge lengths
 *
 * A tet with edge matrix Dm = [X1-X0, X2-X0, X3-X0] has the shape-function gradients g_1..g_3 = rows
 * of Dm^-1 and g_0 = -(g_1+g_2+g_3); a displacement's gradient is G = sum u_a g_a^T.
 * ============================================================================================ */

/* Rows 0..3 of g: the gradients of the four shape functions. Returns the volume. */
static sfem_real sfemi_element_gradients_of(const sfem_real *x0, const sfem_real *x1,
                                            const sfem_real *x2, const sfem_real *x3,
                                            sfem_real g[4][3])
{
    sfem_real e[3][3], volume6;
    int a, i;
    sfemi_sub3(x1, x0, e[0]);
    sfemi_sub3(x2, x0, e[1]);
    sfemi_sub3(x3, x0, e[2]);
    sfemi_cross(e[1], e[2], g[1]);
    sfemi_cross(e[2], e[0], g[2]);
    sfemi_cross(e[0], e[1], g[3]);
    volume6 = sfemi_dot3(e[0], g[1]);
    for (i = 0; i < 3; ++i) {
        for (a = 1; a < 4; ++a) g[a][i] /= volume6;
        g[0][i] = -(g[1][i] + g[2][i] + g[3][i]);
    }
    return volume6 / 6;
}

static sfem_real sfemi_element_gradients(const sfem_mesh *mesh, sfem_int tet, sfem_real g[4][3])
{
    const sfem_int *t = mesh->tet + 4 * (size_t)tet;
    const sfem_real *x = mesh->x;
    return sfemi_element_gradients_of(x + 3 * (size_t)t[0], x + 3 * (size_t)t[1],
                                      x + 3 * (size_t)t[2], x + 3 * (size_t)t[3], g);
}

/* k = V (lambda ga gb^T + mu gb ga^T + mu (ga.gb) I): the block of nodes a, b of K_e. */
static void sfemi_element_block(const sfem_real *ga, const sfem_real *gb, sfem_real lambda_v,
                                sfem_real mu_v, sfem_real k[9])
{
    const sfem_real d = mu_v * sfemi_dot3(ga, gb);
    int i, j;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j)
            k[3 * i + j] = lambda_v * ga[i] * gb[j] + mu_v * gb[i] * ga[j] + (i == j ? d : 0);
}

/* Small-strain tensor of the nodal displacements u, order xx yy zz xy xz yz, engineering shear. */
static void sfemi_element_strain(const sfem_int *t, sfem_real g[4][3], const sfem_real *u,
                                 sfem_real strain[6])
{
    sfem_real grad[3][3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    int a, i, j;
    for (a = 1; a < 4; ++a) { /* differences from node 0, so that a translation gives exactly zero */
        for (i = 0; i < 3; ++i) {
            const sfem_real d = u[3 * (size_t)t[a] + (size_t)i] - u[3 * (size_t)t[0] + (size_t)i];
            for (j = 0; j < 3; ++j) grad[i][j] += d * g[a][j];
        }
    }
    strain[0] = grad[0][0];
    strain[1] = grad[1][1];
    strain[2] = grad[2][2];
    strain[3] = grad[0][1] + grad[1][0];
    strain[4] = grad[0][2] + grad[2][0];
    strain[5] = grad[1][2] + grad[2][1];
}

/* Hooke's law. */
static void sfemi_element_hooke(sfem_real lambda, sfem_real mu, const sfem_real strain[6],
                                sfem_real stress[6])
{
    const sfem_real trace = strain[0] + strain[1] + strain[2];
    int i;
    for (i = 0; i < 3; ++i) stress[i] = lambda * trace + 2 * mu * strain[i];
    for (i = 3; i < 6; ++i) stress[i] = mu * strain[i];
}

/* Below this |F| a tet is a point, and all that is left of F is the rounding of G = F - I: R is then I. */
#define SFEMI_TINY_F       1e-12
#define SFEMI_TINY_F_MIXED 1e-6 /* G in float */

static void sfemi_element_rotation(const sfem_real f[9], sfem_real point, sfem_real r[9])
{
    sfem_real norm2 = 0;
    int i;
    for (i = 0; i < 9; ++i) norm2 += f[i] * f[i];
    if (norm2 < point * point)
        for (i = 0; i < 9; ++i) r[i] = i % 4 ? 0 : 1;
    else
        sfem_polar(f, r, NULL);
}

/* ---- materials, one at a time: F = I + G, so that small G keep their digits ---- */

SFEM_DEF void sfem_law_lame(sfem_real young, sfem_real poisson, sfem_real *lambda, sfem_real *mu)
{
    SFEM_ASSERT(lambda && mu);
    *lambda = young * poisson / ((1 + poisson) * (1 - 2 * poisson));
    *mu = young / (2 * (1 + poisson));
}

/* p = lambda tr(e) I + 2 mu e; returns lambda/2 tr(e)^2 + mu e:e. */
static sfem_real sfemi_law_hooke(sfem_real lambda, sfem_real mu, const sfem_real e[9],
                                 sfem_real p[9])
{
    const sfem_real trace = e[0] + e[4] + e[8];
    sfem_real square = 0;
    int i;
    for (i = 0; i < 9; ++i) {
        square += e[i] * e[i];
        p[i] = 2 * mu * e[i] + (i % 4 ? 0 : lambda * trace);
    }
    return lambda / 2 * trace * trace + mu * square;
}

static sfem_real sfemi_law_corotational(sfem_real lambda, sfem_real mu, const sfem_real f[9],
                                        sfem_real p[9])
{
    sfem_real r[9], trace = 0, square = 0;
    int i;
    sfemi_element_rotation(f, SFEMI_TINY_F, r);
    for (i = 0; i < 9; ++i) {
        const sfem_real d = f[i] - r[i];
        square += d * d;
        trace += r[i] * d; /* tr S - 3 */
    }
    for (i = 0; i < 9; ++i) p[i] = 2 * mu * (f[i] - r[i]) + lambda * trace * r[i];
    return lambda / 2 * trace * trace + mu * square;
}

static sfem_real sfemi_law_stvk(sfem_real lambda, sfem_real mu, const sfem_real g[9],
                                sfem_real p[9])
{
    sfem_real e[9], s[9], gs[9], energy;
    int i, j;
    sfemi_mul3_tn(g, g, e);
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j) e[3 * i + j] = (e[3 * i + j] + g[3 * i + j] + g[3 * j + i]) / 2;
    energy = sfemi_law_hooke(lambda, mu, e, s);
    sfemi_mul3(g, s, gs);
    for (i = 0; i < 9; ++i) p[i] = s[i] + gs[i];
    return energy;
}

/* With i = I_C - 3, j = J - 1, the terms that cancel at rest taken together:
 *     Psi = m/2 (i - 3/2 j - log(1 + i/4)) + l/2 j^2,
 *     P = 3/4 m (F - cof F) + m i/(16 + 4 i) F + l j cof F.  */
static sfem_real sfemi_law_neohookean(sfem_real lambda, sfem_real mu, const sfem_real g[9],
                                      sfem_real p[9])
{
    const sfem_real m = 4 * mu / 3, l = lambda + 5 * mu / 6, trace = g[0] + g[4] + g[8];
    sfem_real c[9], i = 2 * trace, j, a;
    int k;
    sfemi_cofactor3(g, c);
    j = trace + (c[0] + c[4] + c[8]) + sfemi_dot3(g, c);
    for (k = 0; k < 9; ++k) i += g[k] * g[k];
    a = m * i / (16 + 4 * i);
    for (k = 0; k < 9; ++k) {
        const sfem_real one = k % 4 ? 0 : 1, gt = g[3 * (k % 3) + k / 3];
        const sfem_real cof1 = c[k] + one * trace - gt; /* cof F - I */
        p[k] = .75 * m * (g[k] - cof1) + a * (g[k] + one) + l * j * (cof1 + one);
    }
    return m / 2 * (i - 1.5 * j - log1p(i / 4)) + l / 2 * j * j;
}

static sfem_real sfemi_law_stress(sfem_law law, sfem_real lambda, sfem_real mu,
                                  const sfem_real g[9], sfem_real p[9])
{
    sfem_real e[9];
    int i, j;
    switch (law) {
    case SFEM_COROTATIONAL:
        for (i = 0; i < 9; ++i) e[i] = g[i] + (i % 4 ? 0 : 1);
        return sfemi_law_corotational(lambda, mu, e, p);
    case SFEM_STVK:
        return sfemi_law_stvk(lambda, mu, g, p);
    case SFEM_NEOHOOKEAN:
        return sfemi_law_neohookean(lambda, mu, g, p);
    default:
        for (i = 0; i < 3; ++i)
            for (j = 0; j < 3; ++j) e[3 * i + j] = (g[3 * i + j] + g[3 * j + i]) / 2;
        return sfemi_law_hooke(lambda, mu, e, p);
    }
}

/* G = F - I. */
static void sfemi_law_less_one(const sfem_real f[9], sfem_real g[9])
{
    int i;
    for (i = 0; i < 9; ++i) g[i] = f[i] - (i % 4 ? 0 : 1);
}

SFEM_DEF sfem_real sfem_law_stress(sfem_law law, sfem_real lambda, sfem_real mu,
                                   const sfem_real f[9], sfem_real p[9])
{
    sfem_real g[9];
    SFEM_ASSERT(f && p && (unsigned)law <= SFEM_NEOHOOKEAN);
    sfemi_law_less_one(f, g);
    return sfemi_law_stress(law, lambda, mu, g, p);
}

SFEM_DEF sfem_real sfem_law_energy(sfem_law law, sfem_real lambda, sfem_real mu,
                                   const sfem_real f[9])
{
    sfem_real p[9];
    return sfem_law_stress(law, lambda, mu, f, p);
}

/* ---- tangents ----
 *
 * All laws but the linear one depend on the signed singular values s of F = U diag(s) V^T
 * alone, and their dP/dF is simple in that frame: with dF~ = U^T dF V,
 *     dP~_ii = sum_j d2Psi/(ds_i ds_j) dF~_jj,    dP~_ij = both dF~_ij + swap dF~_ji,
 * both +- swap the eigenvalues of the symmetric (flip) and skew (twist) change of the pair ij,
 * (Psi_i - Psi_j)/(s_i - s_j) and (Psi_i + Psi_j)/(s_i + s_j), the quotients done by hand
 * [Smith, de Goes, Kim 2019; Zhu 2021]. The linear law is the same with F = I throughout. */
typedef struct sfemi_modes {
    sfem_real u[9], v[9];
    sfem_real a[9];             /* d2Psi/(ds_i ds_j) */
    sfem_real both[3], swap[3]; /* of the pair without k */
} sfemi_modes;

static const int sfemi_law_pair[3][2] = {{1, 2}, {0, 2}, {0, 1}};

/* The law's derivatives at s: a, and flip and twist by pair. */
static void sfemi_law_derivatives(sfem_law law, sfem_real lambda, sfem_real mu,
                                  const sfem_real s[3], sfem_real a[9], sfem_real flip[3],
                                  sfem_real twist[3])
{
    const sfem_real m = 4 * mu / 3, l = lambda + 5 * mu / 6, det = s[0] * s[1] * s[2];
    const sfem_real norm2 = sfemi_dot3(s, s), green = (norm2 - 3) / 2,
                    trace = s[0] + s[1] + s[2] - 3;
    const sfem_real b = l * (det - 1) - .75 * m, c = m * (1 - 1 / (norm2 + 1));
    const sfem_real d = 2 * m / ((norm2 + 1) * (norm2 + 1));
    int k, i, j;
    for (k = 0; k < 3; ++k) {
        i = sfemi_law_pair[k][0], j = sfemi_law_pair[k][1];
        switch (law) {
        case SFEM_STVK:
            a[4 * k] = lambda * (green + s[k] * s[k]) + mu * (3 * s[k] * s[k] - 1);
            a[3 * i + j] = a[3 * j + i] = lambda * s[i] * s[j];
            flip[k] = lambda * green + mu * (s[i] * s[i] + s[i] * s[j] + s[j] * s[j] - 1);
            twist[k] = lambda * green + mu * (s[i] * s[i] - s[i] * s[j] + s[j] * s[j] - 1);
            break;
        case SFEM_NEOHOOKEAN:
            a[4 * k] = c + d * s[k] * s[k] + l * s[i] * s[j] * s[i] * s[j];
            a[3 * i + j] = a[3 * j + i] = d * s[i] * s[j] + (l * det + b) * s[k];
            flip[k] = c - b * s[k];
            twist[k] = c + b * s[k];
            break;
        default: /* linear: s = 1; the pole of the twist at s_i + s_j = 0 is kept off */
            a[4 * k] = lambda + 2 * mu;
            a[3 * i + j] = a[3 * j + i] = lambda;
            flip[k] = 2 * mu;
            twist[k] = 2 * mu + 2 * (lambda * trace - 2 * mu) / fmax(s[i] + s[j], 1e-8);
        }
    }
}

/* a = the nearest positive semidefinite matrix. */
static void sfemi_law_project(sfem_real a[9])
{
    sfem_real w[3], v[9], copy[9];
    int i, j, k;
    const sfem_real minor = a[0] * a[4] - a[1] * a[1];
    sfemi_cofactor3(a, copy);
    if (a[0] > 0 && minor > 0 && sfemi_dot3(a, copy) > 0) return; /* definite as it is */
    memcpy(copy, a, sizeof copy);
    sfemi_sym_eigen(3, copy, w, v);
    if (w[2] >= 0) return;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j)
            for (k = 0, a[3 * i + j] = 0; k < 3; ++k)
                if (w[k] > 0) a[3 * i + j] += w[k] * v[3 * i + k] * v[3 * j + k];
}

/* As sfem_signed_svd, but small s only to the rounding error of the largest: by R and the
 * eigenvectors of S where F is ordinary. */
static void sfemi_law_svd(const sfem_real f[9], sfem_real u[9], sfem_real s[3], sfem_real v[9])
{
    sfem_real r[9], rtf[9];
    if (!sfemi_polar_fast(f, r)) {
        sfem_signed_svd(f, u, s, v);
        return;
    }
    sfemi_mul3_tn(r, f, rtf);
    sfemi_sym_eigen(3, rtf, s, v);
    sfemi_mul3(r, v, u);
}

static void sfemi_law_modes(sfem_law law, sfem_real lambda, sfem_real mu, const sfem_real g[9],
                            sfem_tangent kind, sfemi_modes *m)
{
    sfem_real f[9], s[3] = {1, 1, 1}, flip[3], twist[3];
    int i;
    for (i = 0; i < 9; ++i) {
        m->u[i] = m->v[i] = i % 4 ? 0 : 1;
        f[i] = g[i] + m->u[i];
    }
    if (law == SFEM_COROTATIONAL && kind == SFEM_TANGENT_FROZEN)
        sfemi_element_rotation(f, SFEMI_TINY_F, m->u);
    else if (law != SFEM_LINEAR)
        sfemi_law_svd(f, m->u, s, m->v);
    sfemi_law_derivatives(law, lambda, mu, s, m->a, flip, twist);
    if (kind != SFEM_TANGENT_EXACT && law >= SFEM_STVK) sfemi_law_project(m->a);
    for (i = 0; i < 3; ++i) {
        if (kind != SFEM_TANGENT_EXACT) {
            flip[i] = fmax(flip[i], 0.0);
            twist[i] =
                law == SFEM_COROTATIONAL && kind == SFEM_TANGENT_FROZEN ? 0 : fmax(twist[i], 0.0);
        }
        m->both[i] = (flip[i] + twist[i]) / 2;
        m->swap[i] = (flip[i] - twist[i]) / 2;
    }
}

static void sfemi_modes_apply(const sfemi_modes *m, const sfem_real df[9], sfem_real dp[9])
{
    sfem_real t[9], x[9], y[9];
    int k, i, j;
    sfemi_mul3_tn(m->u, df, t);
    sfemi_mul3(t, m->v, x);
    for (k = 0; k < 3; ++k) {
        i = sfemi_law_pair[k][0], j = sfemi_law_pair[k][1];
        y[4 * k] = m->a[3 * k] * x[0] + m->a[3 * k + 1] * x[4] + m->a[3 * k + 2] * x[8];
        y[3 * i + j] = m->both[k] * x[3 * i + j] + m->swap[k] * x[3 * j + i];
        y[3 * j + i] = m->both[k] * x[3 * j + i] + m->swap[k] * x[3 * i + j];
    }
    sfemi_mul3(m->u, y, t);
    sfemi_mul3_nt(t, m->v, dp);
}

SFEM_DEF void sfem_law_differential(sfem_law law, sfem_real lambda, sfem_real mu,
                                    const sfem_real f[9], sfem_tangent kind, const sfem_real df[9],
                                    sfem_real dp[9])
{
    sfem_real g[9];
    sfemi_modes modes;
    SFEM_ASSERT(f && df && dp && (unsigned)law <= SFEM_NEOHOOKEAN);
    sfemi_law_less_one(f, g);
    sfemi_law_modes(law, lambda, mu, g, kind, &modes);
    sfemi_modes_apply(&modes, df, dp);
}

SFEM_DEF void sfem_law_tangent(sfem_law law, sfem_real lambda, sfem_real mu, const sfem_real f[9],
                               sfem_tangent kind, sfem_real tangent[81])
{
    sfem_real g[9], df[9] = {0};
    sfemi_modes modes;
    int a;
    SFEM_ASSERT(f && tangent && (unsigned)law <= SFEM_NEOHOOKEAN);
    sfemi_law_less_one(f, g);
    sfemi_law_modes(law, lambda, mu, g, kind, &modes);
    for (a = 0; a < 9; ++a) {
        df[a] = 1;
        sfemi_modes_apply(&modes, df, tangent + 9 * a);
        df[a] = 0;
    }
}

/* The stiffness of a tet by blocks of its node pairs a >= b, in the order 00 10 11 20 .. 33,
 * all at once: the pairs are lanes of a vector. */
#define SFEMI_PAIRS 12 /* ten, and two that are zero */

typedef struct sfemi_pairs {
    sfem_real a[3][SFEMI_PAIRS],
        b[3][SFEMI_PAIRS];       /* shape gradients of both nodes in the frame V */
    sfem_real x[9][SFEMI_PAIRS]; /* the blocks in the frame U, */
    sfem_real k[9][SFEMI_PAIRS]; /* and in that of the world */
} sfemi_pairs;

/* Bit p of swap: pair p wants the block of (b, a) instead of (a, b). */
static void sfemi_pairs_fill(const sfemi_modes *m, sfem_real g[4][3], unsigned swap, sfemi_pairs *w)
{
    sfem_real in_v[4][3];
    int a, b, i, p;
    for (a = 0; a < 4; ++a)
        for (i = 0; i < 3; ++i)
            in_v[a][i] = g[a][0] * m->v[i] + g[a][1] * m->v[3 + i] + g[a][2] * m->v[6 + i];
    for (a = 0, p = 0; a < 4; ++a)
        for (b = 0; b <= a; ++b, ++p)
            for (i = 0; i < 3; ++i) {
                w->a[i][p] = in_v[swap >> p & 1 ? b : a][i];
                w->b[i][p] = in_v[swap >> p & 1 ? a : b][i];
            }
    for (i = 0; i < 3; ++i) w->a[i][10] = w->a[i][11] = w->b[i][10] = w->b[i][11] = 0;
}

/* x = volume ga.(dP/dF).gb in its entries nn, ij and ji; n, i, j are constants, all different. */
static SFEMI_INLINE void sfemi_pairs_entries(const sfemi_modes *m, sfem_real volume, sfemi_pairs *w,
                                             const int n, const int i, const int j)
{
    const sfem_real ann = volume * m->a[4 * n], aij = volume * m->a[3 * i + j];
    const sfem_real swap = volume * m->swap[n], bi = volume * m->both[i], bj = volume * m->both[j];
    int p;
    for (p = 0; p < SFEMI_PAIRS; ++p) {
        const sfem_real an = w->a[n][p], ai = w->a[i][p], aj = w->a[j][p];
        const sfem_real cn = w->b[n][p], ci = w->b[i][p], cj = w->b[j][p];
        w->x[4 * n][p] = ann * an * cn + bj * ai * ci + bi * aj * cj;
        w->x[3 * i + j][p] = aij * ai * cj + swap * aj * ci;
        w->x[3 * j + i][p] = aij * aj * ci + swap * ai * cj;
    }
}

static SFEMI_INLINE void sfemi_pairs_blocks(const sfemi_modes *m, sfem_real volume, sfemi_pairs *w)
{
    int p, i;
    sfemi_pairs_entries(m, volume, w, 0, 1, 2);
    sfemi_pairs_entries(m, volume, w, 1, 0, 2);
    sfemi_pairs_entries(m, volume, w, 2, 0, 1);
    for (i = 0; i < 3; ++i) { /* k = u x u^T, by rows of u x */
        const sfem_real a = m->u[3 * i], b = m->u[3 * i + 1], c = m->u[3 * i + 2];
        for (p = 0; p < SFEMI_PAIRS; ++p) {
            const sfem_real t0 = a * w->x[0][p] + b * w->x[3][p] + c * w->x[6][p];
            const sfem_real t1 = a * w->x[1][p] + b * w->x[4][p] + c * w->x[7][p];
            const sfem_real t2 = a * w->x[2][p] + b * w->x[5][p] + c * w->x[8][p];
            w->k[3 * i][p] = t0 * m->u[0] + t1 * m->u[1] + t2 * m->u[2];
            w->k[3 * i + 1][p] = t0 * m->u[3] + t1 * m->u[4] + t2 * m->u[5];
            w->k[3 * i + 2][p] = t0 * m->u[6] + t1 * m->u[7] + t2 * m->u[8];
        }
    }
}

typedef void (*sfemi_pairs_kernel)(const sfemi_modes *m, sfem_real volume, sfemi_pairs *w);

static void sfemi_pairs_portable(const sfemi_modes *m, sfem_real volume, sfemi_pairs *w)
{
    sfemi_pairs_blocks(m, volume, w);
}

#if SFEMI_X86
SFEMI_AVX2 static void sfemi_pairs_avx2(const sfemi_modes *m, sfem_real volume, sfemi_pairs *w)
{
    sfemi_pairs_blocks(m, volume, w);
}
#endif

static sfemi_pairs_kernel sfemi_pairs_pick(void)
{
#if SFEMI_X86
    if (sfemi_path() > 0) return sfemi_pairs_avx2;
#endif
    return sfemi_pairs_portable;
}

/* G = sum (u_a - u_0) g_a^T: a translation gives exactly zero. */
static void sfemi_element_deform(const sfem_real *u0, const sfem_real *u1, const sfem_real *u2,
                                 const sfem_real *u3, sfem_real g[4][3], sfem_real grad[9])
{
    int i, j;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j)
            grad[3 * i + j] =
                (u1[i] - u0[i]) * g[1][j] + (u2[i] - u0[i]) * g[2][j] + (u3[i] - u0[i]) * g[3][j];
}

SFEM_DEF sfem_real sfem_law_tet(sfem_law law, sfem_real lambda, sfem_real mu, const sfem_real x[12],
                                const sfem_real u[12], sfem_tangent kind, sfem_real force[12],
                                sfem_real k[144])
{
    sfem_real g[4][3], grad[9], p[9], volume, energy;
    sfemi_modes modes;
    sfemi_pairs pairs;
    int a, b, i, n;
    SFEM_ASSERT(x && u && (unsigned)law <= SFEM_NEOHOOKEAN);
    volume = sfemi_element_gradients_of(x, x + 3, x + 6, x + 9, g);
    sfemi_element_deform(u, u + 3, u + 6, u + 9, g, grad);
    energy = volume * sfemi_law_stress(law, lambda, mu, grad, p);
    for (a = 0; force && a < 4; ++a)
        for (i = 0; i < 3; ++i) force[3 * a + i] = volume * sfemi_dot3(p + 3 * i, g[a]);
    if (!k) return energy;
    sfemi_law_modes(law, lambda, mu, grad, kind, &modes);
    sfemi_pairs_fill(&modes, g, 0, &pairs);
    sfemi_pairs_portable(&modes, volume, &pairs);
    for (a = 0, n = 0; a < 4; ++a)
        for (b = 0; b <= a; ++b, ++n)
            for (i = 0; i < 9; ++i) {
                k[12 * (3 * a + i / 3) + 3 * b + i % 3] = pairs.k[i][n];
                k[12 * (3 * b + i % 3) + 3 * a + i / 3] = pairs.k[i][n];
            }
    return energy;
}

/* ---- energies in edge lengths ---- */

static const int sfemi_edge_node[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};
static const int sfemi_edge_node2[3][2] = {{0, 1}, {0, 2}, {1, 2}};

static const int *sfemi_edge_ends(int dim, int k)
{
    return dim == 3 ? sfemi_edge_node[k] : sfemi_edge_node2[k];
}

SFEM_DEF void sfem_edge_lengths2(int dim, const sfem_real *x, sfem_real *d2)
{
    int k, i;
    SFEM_ASSERT((dim == 2 || dim == 3) && x && d2);
    for (k = 0; k < (dim == 3 ? 6 : 3); ++k) {
        const int *end = sfemi_edge_ends(dim, k);
        for (i = 0, d2[k] = 0; i < dim; ++i) {
            const sfem_real d = x[dim * end[0] + i] - x[dim * end[1] + i];
            d2[k] += d * d;
        }
    }
}

/* Row k of q: n n^T of edge k as a vector, entries off the diagonal times sqrt 2, so that the
 * product with a symmetric tensor written the same way is n.C n. Zero for an edge without
 * length. */
static void sfemi_edge_rows(int dim, const sfem_real *x, const sfem_real *length2, sfem_real *q)
{
    const int edges = dim == 3 ? 6 : 3;
    int k, i, j, at;
    for (k = 0; k < edges; ++k) {
        const int *end = sfemi_edge_ends(dim, k);
        sfem_real n[3];
        for (i = 0; i < dim; ++i)
            n[i] =
                length2[k] > 0 ? (x[dim * end[0] + i] - x[dim * end[1] + i]) / sqrt(length2[k]) : 0;
        for (i = 0, at = 0; i < dim; ++i) q[edges * k + at++] = n[i] * n[i];
        for (i = 0; i < dim; ++i)
            for (j = i + 1; j < dim; ++j) q[edges * k + at++] = sqrt(2.0) * n[i] * n[j];
    }
}

/* w = the pseudo-inverse of q [m][m], which becomes b = q v with orthogonal columns: w is the
 * sum of v_e b_e^T / |b_e|^2 over those columns e that are not zero. Returns their number. */
static int sfemi_edge_pseudo_inverse(int m, sfem_real *q, sfem_real *w)
{
    sfem_real v[36], square[6], largest = 0;
    int sweep, turned = 1, e, i, k, rank = 0;
    for (i = 0; i < m * m; ++i) v[i] = i % (m + 1) ? 0 : 1;
    for (sweep = 0; sweep < 30 && turned; ++sweep)
        for (turned = 0, e = 1; e < m; ++e)
            for (i = 0; i < e; ++i) turned |= sfemi_svd_turn(m, q, v, i, e);
    for (e = 0; e < m; ++e) {
        for (k = 0, square[e] = 0; k < m; ++k) square[e] += q[m * k + e] * q[m * k + e];
        largest = fmax(largest, square[e]);
    }
    memset(w, 0, (size_t)(m * m) * sizeof *w);
    for (e = 0; e < m; ++e) {
        if (!(square[e] > 1e-24 * largest)) continue;
        ++rank;
        for (i = 0; i < m; ++i)
            for (k = 0; k < m; ++k) w[m * i + k] += v[m * i + e] * q[m * k + e] / square[e];
    }
    return rank;
}

SFEM_DEF void sfem_edge_prepare(int dim, const sfem_real *x, sfem_edge_shape *out)
{
    sfem_real q[36], w[36], length2[6];
    int k, i, j, at;
    SFEM_ASSERT((dim == 2 || dim == 3) && x && out);
    memset(out, 0, sizeof *out);
    out->dim = dim;
    out->nodes = dim + 1;
    out->edges = dim == 3 ? 6 : 3;
    out->volume = dim == 3
                      ? fabs(sfemi_volume6(x, x + 3, x + 6, x + 9)) / 6
                      : fabs((x[2] - x[0]) * (x[5] - x[1]) - (x[3] - x[1]) * (x[4] - x[0])) / 2;
    sfem_edge_lengths2(dim, x, length2);
    sfemi_edge_rows(dim, x, length2, q);
    out->rank = sfemi_edge_pseudo_inverse(out->edges, q, w);
    for (k = 0; k < out->edges; ++k) {
        const sfem_real scale = length2[k] > 0 ? 1 / length2[k] : 0;
        for (i = 0; i < dim; ++i) out->c[k][(dim + 1) * i] = scale * w[out->edges * i + k];
        for (i = 0, at = dim; i < dim; ++i)
            for (j = i + 1; j < dim; ++j, ++at)
                out->c[k][dim * i + j] = out->c[k][dim * j + i] =
                    scale * w[out->edges * at + k] / sqrt(2.0);
    }
}

SFEM_DEF void sfem_edge_cauchy_green(const sfem_edge_shape *shape, const sfem_real *d2,
                                     sfem_real *c)
{
    int i, k;
    SFEM_ASSERT(shape && d2 && c);
    for (i = 0; i < shape->dim * shape->dim; ++i)
        for (k = 0, c[i] = 0; k < shape->edges; ++k) c[i] += shape->c[k][i] * d2[k];
}

/* C as a 3x3 matrix: a triangle's in plane strain. */
static void sfemi_edge_tensor(const sfem_edge_shape *shape, const sfem_real *d2, sfem_real c[9])
{
    sfem_real plane[4];
    if (shape->dim == 3) {
        sfem_edge_cauchy_green(shape, d2, c);
        return;
    }
    sfem_edge_cauchy_green(shape, d2, plane);
    memset(c, 0, 9 * sizeof *c);
    c[0] = plane[0], c[1] = c[3] = plane[1], c[4] = plane[3], c[8] = 1;
}

SFEM_DEF void sfem_edge_invariants(const sfem_edge_shape *shape, const sfem_real *d2,
                                   const sfem_real *fibre, sfem_real invariants[5])
{
    const int dim = shape->dim;
    sfem_real c[9], cof[9], ca;
    int i, j;
    SFEM_ASSERT(d2 && invariants);
    sfem_edge_cauchy_green(shape, d2, c);
    memset(invariants, 0, 5 * sizeof *invariants);
    for (i = 0; i < dim; ++i) {
        invariants[0] += c[(dim + 1) * i];
        for (j = 0, ca = 0; j < dim; ++j) {
            invariants[1] += c[dim * i + j] * c[dim * i + j];
            if (fibre) ca += c[dim * i + j] * fibre[j];
        }
        if (!fibre) continue;
        invariants[3] += fibre[i] * ca;
        invariants[4] += ca * ca;
    }
    if (dim == 2) {
        invariants[2] = c[0] * c[3] - c[1] * c[2];
        return;
    }
    sfemi_cofactor3(c, cof);
    invariants[2] = sfemi_dot3(c, cof);
}

/* dPsi/dC, with C = I + c. */
static sfem_real sfemi_edge_stress(sfem_law law, sfem_real lambda, sfem_real mu,
                                   const sfem_real c[9], sfem_real s[9])
{
    const sfem_real m = 4 * mu / 3, l = lambda + 5 * mu / 6, i = c[0] + c[4] + c[8];
    sfem_real full[9], e[9], cof[9], third, det, volume, a;
    int k;
    if (law == SFEM_STVK) {
        for (k = 0; k < 9; ++k) e[k] = c[k] / 2;
        a = sfemi_law_hooke(lambda, mu, e, s);
        for (k = 0; k < 9; ++k) s[k] /= 2;
        return a;
    }
    sfemi_cofactor3(c, cof);
    third = i + (cof[0] + cof[4] + cof[8]) + sfemi_dot3(c, cof); /* III_C - 1 */
    for (k = 0; k < 9; ++k) full[k] = c[k] + (k % 4 ? 0 : 1);
    sfemi_cofactor3(full, cof);
    det = sqrt(fmax(1 + third, 0.0));
    volume = third > -1 ? third / (1 + det) : -1; /* J - 1 */
    a = (l * volume - .75 * m) / (2 * fmax(det, 1e-8));
    for (k = 0; k < 9; ++k) s[k] = a * cof[k] + (k % 4 ? 0 : m / 2 * (3 + i) / (4 + i));
    return m / 2 * (i - 1.5 * volume - log1p(i / 4)) + l / 2 * volume * volume;
}

SFEM_DEF sfem_real sfem_edge_energy(const sfem_edge_shape *shape, sfem_law law, sfem_real lambda,
                                    sfem_real mu, const sfem_real *d2, sfem_real *slope)
{
    sfem_real c[9], s[9], energy;
    int k, i, j;
    SFEM_ASSERT(shape && d2 && (law == SFEM_STVK || law == SFEM_NEOHOOKEAN));
    sfemi_edge_tensor(shape, d2, c);
    for (i = 0; i < 9; i += 4) c[i] -= 1;
    energy = sfemi_edge_stress(law, lambda, mu, c, s);
    for (k = 0; slope && k < shape->edges; ++k)
        for (i = 0, slope[k] = 0; i < shape->dim; ++i)
            for (j = 0; j < shape->dim; ++j)
                slope[k] += s[3 * i + j] * shape->c[k][shape->dim * i + j];
    return energy;
}

SFEM_DEF void sfem_edge_forces(const sfem_edge_shape *shape, const sfem_real *x,
                               const sfem_real *slope, sfem_real *force)
{
    const int dim = shape->dim;
    int k, i;
    SFEM_ASSERT(x && slope && force);
    for (i = 0; i < dim * shape->nodes; ++i) force[i] = 0;
    for (k = 0; k < shape->edges; ++k) {
        const int *end = sfemi_edge_ends(dim, k);
        for (i = 0; i < dim; ++i) {
            const sfem_real d =
                2 * shape->volume * slope[k] * (x[dim * end[0] + i] - x[dim * end[1] + i]);
            force[dim * end[0] + i] += d;
            force[dim * end[1] + i] -= d;
        }
    }
}

/* ---- the same for many tets at once ----
 *
 * Tets of one law come in blocks of SFEMI_LANES, the data of a block by lanes, so that each
 * loop over lanes below is straight-line arithmetic that a compiler turns into vector
 * instructions (gcc from 12 on and clang at -O2). SFEMI_LANE_KERNELS holds it once, for double
 * and float; the paths below it compile that for several instruction sets. `fused` is a
 * constant there: fused multiply-adds are asked for by name, so that the bits of a result
 * depend on the path and on nothing else. */
#define SFEMI_LANES 16

typedef struct sfemi_block {
    sfem_real shape[9][SFEMI_LANES];  /* gradients of nodes 1, 2, 3, 1/m */
    sfem_real lambda[SFEMI_LANES];    /* times the volume, J; 0 in lanes that fill up */
    sfem_real mu[SFEMI_LANES];
    sfem_int node[4][SFEMI_LANES];    /* 4 times the node's number within the chunk */
    sfem_int tet[SFEMI_LANES];
    sfem_int law, count;              /* so many lanes are tets, the others copies of the last */
    sfem_int pad[14];                 /* to whole cache lines */
} sfemi_block;

/* What a run over blocks adds up, by lanes. */
typedef struct sfemi_totals {
    sfem_real energy[SFEMI_LANES], inverted[SFEMI_LANES]; /* inverted: tets with det F <= 0 */
} sfemi_totals;

/* Adds to out the internal forces of count blocks displaced by u, both [nodes of the chunk][4];
 * the nearest rotations go to rotation [tets][9], if not NULL. */
typedef void (*sfemi_blocks_kernel)(const sfemi_block *block, sfem_int count, const sfem_real *u,
                                    sfem_real *out, sfem_real *rotation, sfemi_totals *totals);

#if defined(__GNUC__)
#define SFEMI_FMA_d(a, b, c) __builtin_fma(a, b, c)
#define SFEMI_FMA_f(a, b, c) __builtin_fmaf(a, b, c)
#else
#define SFEMI_FMA_d(a, b, c) ((a) * (b) + (c))
#define SFEMI_FMA_f(a, b, c) ((a) * (b) + (c))
#endif

/* d = u_a - u_0 by lanes, a = 1, 2, 3; and out_a += d, out_0 -= the sum of d. */
typedef void (*sfemi_gather)(const sfemi_block *block, const sfem_real *u,
                             sfem_real d[9][SFEMI_LANES]);
typedef void (*sfemi_scatter)(const sfemi_block *block, const sfem_real d[9][SFEMI_LANES],
                              sfem_real *out);

static void sfemi_gather_portable(const sfemi_block *block, const sfem_real *u,
                                  sfem_real d[9][SFEMI_LANES])
{
    int l, i;
    for (l = 0; l < SFEMI_LANES; ++l) {
        const sfem_real *u0 = u + block->node[0][l], *u1 = u + block->node[1][l];
        const sfem_real *u2 = u + block->node[2][l], *u3 = u + block->node[3][l];
        for (i = 0; i < 3; ++i) {
            d[i][l] = u1[i] - u0[i];
            d[3 + i][l] = u2[i] - u0[i];
            d[6 + i][l] = u3[i] - u0[i];
        }
    }
}

static void sfemi_scatter_portable(const sfemi_block *block, const sfem_real d[9][SFEMI_LANES],
                                   sfem_real *out)
{
    int l, i;
    for (l = 0; l < block->count; ++l) {
        sfem_real *f0 = out + block->node[0][l], *f1 = out + block->node[1][l];
        sfem_real *f2 = out + block->node[2][l], *f3 = out + block->node[3][l];
        for (i = 0; i < 3; ++i) {
            f0[i] -= d[i][l] + d[3 + i][l] + d[6 + i][l];
            f1[i] += d[i][l];
            f2[i] += d[3 + i][l];
            f3[i] += d[6 + i][l];
        }
    }
}

#if SFEMI_X86
/* Rows <-> columns of four vectors of four. */
SFEMI_AVX2 static inline void sfemi_transpose_avx2(__m256d v[4])
{
    const __m256d a = _mm256_unpacklo_pd(v[0], v[1]), b = _mm256_unpackhi_pd(v[0], v[1]);
    const __m256d c = _mm256_unpacklo_pd(v[2], v[3]), d = _mm256_unpackhi_pd(v[2], v[3]);
    v[0] = _mm256_permute2f128_pd(a, c, 0x20);
    v[1] = _mm256_permute2f128_pd(b, d, 0x20);
    v[2] = _mm256_permute2f128_pd(a, c, 0x31);
    v[3] = _mm256_permute2f128_pd(b, d, 0x31);
}

SFEMI_AVX2 static void sfemi_gather_avx2(const sfemi_block *block, const sfem_real *u,
                                         sfem_real d[9][SFEMI_LANES])
{
    int l, a;
    for (l = 0; l < SFEMI_LANES; l += 4) {
        const __m256d a0 = _mm256_loadu_pd(u + block->node[0][l]);
        const __m256d a1 = _mm256_loadu_pd(u + block->node[0][l + 1]);
        const __m256d a2 = _mm256_loadu_pd(u + block->node[0][l + 2]);
        const __m256d a3 = _mm256_loadu_pd(u + block->node[0][l + 3]);
        for (a = 0; a < 3; ++a) {
            const sfem_int *node = block->node[a + 1] + l;
            __m256d v[4];
            v[0] = _mm256_sub_pd(_mm256_loadu_pd(u + node[0]), a0);
            v[1] = _mm256_sub_pd(_mm256_loadu_pd(u + node[1]), a1);
            v[2] = _mm256_sub_pd(_mm256_loadu_pd(u + node[2]), a2);
            v[3] = _mm256_sub_pd(_mm256_loadu_pd(u + node[3]), a3);
            sfemi_transpose_avx2(v);
            _mm256_storeu_pd(d[3 * a] + l, v[0]);
            _mm256_storeu_pd(d[3 * a + 1] + l, v[1]);
            _mm256_storeu_pd(d[3 * a + 2] + l, v[2]);
        }
    }
}

SFEMI_AVX2 static inline void sfemi_add_avx2(sfem_real *to, __m256d v)
{
    _mm256_storeu_pd(to, _mm256_add_pd(_mm256_loadu_pd(to), v));
}

SFEMI_AVX2 static void sfemi_scatter_avx2(const sfemi_block *block,
                                          const sfem_real d[9][SFEMI_LANES], sfem_real *out)
{
    int l, a;
    for (l = 0; l < SFEMI_LANES; l += 4) { /* lanes that fill up add zero */
        __m256d s0 = _mm256_setzero_pd(), s1 = s0, s2 = s0, s3 = s0;
        for (a = 0; a < 3; ++a) {
            const sfem_int *node = block->node[a + 1] + l;
            __m256d v[4];
            v[0] = _mm256_loadu_pd(d[3 * a] + l);
            v[1] = _mm256_loadu_pd(d[3 * a + 1] + l);
            v[2] = _mm256_loadu_pd(d[3 * a + 2] + l);
            v[3] = _mm256_setzero_pd();
            sfemi_transpose_avx2(v);
            sfemi_add_avx2(out + node[0], v[0]);
            sfemi_add_avx2(out + node[1], v[1]);
            sfemi_add_avx2(out + node[2], v[2]);
            sfemi_add_avx2(out + node[3], v[3]);
            s0 = _mm256_sub_pd(s0, v[0]);
            s1 = _mm256_sub_pd(s1, v[1]);
            s2 = _mm256_sub_pd(s2, v[2]);
            s3 = _mm256_sub_pd(s3, v[3]);
        }
        sfemi_add_avx2(out + block->node[0][l], s0);
        sfemi_add_avx2(out + block->node[0][l + 1], s1);
        sfemi_add_avx2(out + block->node[0][l + 2], s2);
        sfemi_add_avx2(out + block->node[0][l + 3], s3);
    }
}
#endif

/* R of a lane that the fast way has given up. */
static void sfemi_lanes_repair(const sfem_real g[9], sfem_real point, sfem_real r[9])
{
    sfem_real f[9];
    int i;
    for (i = 0; i < 9; ++i) f[i] = g[i] + (i % 4 ? 0 : 1);
    sfemi_element_rotation(f, point, r);
}

/* Is any of the flags, 0 or 1, not 0? */
static SFEMI_INLINE int sfemi_lanes_any(const void *flags, size_t bytes)
{
    uint64_t word[SFEMI_LANES], any = 0;
    size_t i;
    memcpy(word, flags, bytes);
    for (i = 0; i < bytes / sizeof *word; ++i) any |= word[i];
    return any != 0;
}

/* MA = a b + c, DOT = a0 b0 + a1 b1 + a2 b2, DET = a b - c d, rounded as the path does it */
#define SFEMI_LANE_ARITHMETIC(T, S)                                                                \
static SFEMI_INLINE T sfemi_ma_##S(const int fused, T a, T b, T c)                                 \
{                                                                                                  \
    return fused ? SFEMI_FMA_##S(a, b, c) : a * b + c;                                             \
}                                                                                                  \
static SFEMI_INLINE T sfemi_dot_##S(const int fused, T a0, T b0, T a1, T b1, T a2, T b2)           \
{                                                                                                  \
    return sfemi_ma_##S(fused, a0, b0, sfemi_ma_##S(fused, a1, b1, a2 * b2));                      \
}                                                                                                  \
static SFEMI_INLINE T sfemi_det_##S(const int fused, T a, T b, T c, T d)                           \
{                                                                                                  \
    return sfemi_ma_##S(fused, a, b, -(c * d));                                                    \
}
SFEMI_LANE_ARITHMETIC(double, d)
SFEMI_LANE_ARITHMETIC(float, f)
#define SFEMI_MA_d(a, b, c)                sfemi_ma_d(fused, a, b, c)
#define SFEMI_MA_f(a, b, c)                sfemi_ma_f(fused, a, b, c)
#define SFEMI_DOT_d(a0, b0, a1, b1, a2, b2) sfemi_dot_d(fused, a0, b0, a1, b1, a2, b2)
#define SFEMI_DOT_f(a0, b0, a1, b1, a2, b2) sfemi_dot_f(fused, a0, b0, a1, b1, a2, b2)
#define SFEMI_DET_d(a, b, c, d)            sfemi_det_d(fused, a, b, c, d)
#define SFEMI_DET_f(a, b, c, d)            sfemi_det_f(fused, a, b, c, d)

#define SFEMI_LANE_KERNELS(T, S, MA, DOT, DET, STEP, ROUND)                                        \
typedef struct sfemi_lanes_##S {                                                                   \
    sfem_real d[9][SFEMI_LANES]; /* u_a - u_0, a = 1, 2, 3; later the forces on those nodes */     \
    T g[9][SFEMI_LANES];      /* displacement gradient G = F - I */                                \
    T r[9][SFEMI_LANES];      /* F, later the rotation nearest to it */                            \
    T c[9][SFEMI_LANES];      /* cof F */                                                          \
    T k[3][SFEMI_LANES];      /* t^2 + |F|^2, -2, 2 t, each over the slope */                      \
    T s[6][SFEMI_LANES];      /* k0 I + k1 F^T F */                                                \
    T p[9][SFEMI_LANES];      /* stress times volume */                                            \
    T lambda[SFEMI_LANES], mu[SFEMI_LANES], energy[SFEMI_LANES];                                   \
    T det[SFEMI_LANES], norm2[SFEMI_LANES], constant[SFEMI_LANES]; /* of p(t), sfemi_polar_fast */ \
    T trace[SFEMI_LANES], bad[SFEMI_LANES];                                                        \
} sfemi_lanes_##S;                                                                                 \
                                                                                                   \
/* G and det F */                                                                                  \
static SFEMI_INLINE void sfemi_lanes_deform_##S(sfemi_lanes_##S *w, const sfemi_block *block,      \
                                                const int fused)                                   \
{                                                                                                  \
    int l, i;                                                                                      \
    for (i = 0; i < 3; ++i)                                                                        \
        for (l = 0; l < SFEMI_LANES; ++l) {                                                        \
            const T a = (T)w->d[i][l], b = (T)w->d[3 + i][l], c = (T)w->d[6 + i][l];               \
            w->g[3 * i][l] =                                                                       \
                DOT(a, (T)block->shape[0][l], b, (T)block->shape[3][l], c, (T)block->shape[6][l]); \
            w->g[3 * i + 1][l] =                                                                   \
                DOT(a, (T)block->shape[1][l], b, (T)block->shape[4][l], c, (T)block->shape[7][l]); \
            w->g[3 * i + 2][l] =                                                                   \
                DOT(a, (T)block->shape[2][l], b, (T)block->shape[5][l], c, (T)block->shape[8][l]); \
        }                                                                                          \
    for (l = 0; l < SFEMI_LANES; ++l) {                                                            \
        const T f0 = w->g[0][l] + 1, f1 = w->g[1][l], f2 = w->g[2][l];                             \
        const T f3 = w->g[3][l], f4 = w->g[4][l] + 1, f5 = w->g[5][l];                             \
        const T f6 = w->g[6][l], f7 = w->g[7][l], f8 = w->g[8][l] + 1;                             \
        w->det[l] = DOT(f0, DET(f4, f8, f5, f7),                                                   \
                                  f1, DET(f5, f6, f3, f8),                                         \
                                  f2, DET(f3, f7, f4, f6));                                        \
        w->lambda[l] = (T)block->lambda[l];                                                        \
        w->mu[l] = (T)block->mu[l];                                                                \
    }                                                                                              \
}                                                                                                  \
                                                                                                   \
/* F, cof F, |F|^2, the constant of p(t) and a first trace: (|F|^2 + 3)/2 >= sqrt(3 |F|^2) >= t */ \
static SFEMI_INLINE void sfemi_lanes_quartic_##S(sfemi_lanes_##S *w, const int fused)              \
{                                                                                                  \
    int l;                                                                                         \
    for (l = 0; l < SFEMI_LANES; ++l) {                                                            \
        const T f0 = w->g[0][l] + 1, f1 = w->g[1][l], f2 = w->g[2][l];                             \
        const T f3 = w->g[3][l], f4 = w->g[4][l] + 1, f5 = w->g[5][l];                             \
        const T f6 = w->g[6][l], f7 = w->g[7][l], f8 = w->g[8][l] + 1;                             \
        const T c0 = DET(f4, f8, f5, f7), c1 = DET(f5, f6, f3, f8);                                \
        const T c2 = DET(f3, f7, f4, f6), c3 = DET(f2, f7, f1, f8);                                \
        const T c4 = DET(f0, f8, f2, f6), c5 = DET(f1, f6, f0, f7);                                \
        const T c6 = DET(f1, f5, f2, f4), c7 = DET(f2, f3, f0, f5);                                \
        const T c8 = DET(f0, f4, f1, f3);                                                          \
        const T n = DOT(f0, f0, f1, f1, f2, f2) + DOT(f3, f3, f4, f4, f5, f5) +                    \
                    DOT(f6, f6, f7, f7, f8, f8);                                                   \
        const T m = DOT(c0, c0, c1, c1, c2, c2) + DOT(c3, c3, c4, c4, c5, c5) +                    \
                    DOT(c6, c6, c7, c7, c8, c8);                                                   \
        w->c[0][l] = c0, w->c[1][l] = c1, w->c[2][l] = c2;                                         \
        w->c[3][l] = c3, w->c[4][l] = c4, w->c[5][l] = c5;                                         \
        w->c[6][l] = c6, w->c[7][l] = c7, w->c[8][l] = c8;                                         \
        w->r[0][l] = f0, w->r[1][l] = f1, w->r[2][l] = f2;                                         \
        w->r[3][l] = f3, w->r[4][l] = f4, w->r[5][l] = f5;                                         \
        w->r[6][l] = f6, w->r[7][l] = f7, w->r[8][l] = f8;                                         \
        w->norm2[l] = n;                                                                           \
        w->constant[l] = MA(n, n, -4 * m);                                                         \
        w->trace[l] = (n + 3) / 2;                                                                 \
    }                                                                                              \
}                                                                                                  \
                                                                                                   \
/* one step of Halley's method for the trace */                                                    \
static SFEMI_INLINE void sfemi_lanes_halley_##S(sfemi_lanes_##S *w, const int fused)               \
{                                                                                                  \
    int l;                                                                                         \
    for (l = 0; l < SFEMI_LANES; ++l) {                                                            \
        const T t = w->trace[l], n = w->norm2[l], d = w->det[l], t2 = t * t;                       \
        const T p = MA(MA(t2 - 2 * n, t, -8 * d), t, w->constant[l]);                              \
        const T slope = MA(t2 - n, t, -2 * d);                                                     \
        const T half = (3 * t2 - n) / 2;                                                           \
        const T step = p * slope / DET(4 * slope, slope, p, half);                                 \
                w->trace[l] = t - step;                                                            \
        w->bad[l] = step <= (T)STEP * (t - step) ? 0 : 1; /* also where step is not a number */    \
    }                                                                                              \
}                                                                                                  \
                                                                                                   \
/* R = F (k0 I + k1 F^T F) + k2 cof F, row by row in place of F */                                 \
static SFEMI_INLINE void sfemi_lanes_rotation_##S(sfemi_lanes_##S *w, const int fused)             \
{                                                                                                  \
    int l, i;                                                                                      \
    for (l = 0; l < SFEMI_LANES; ++l) {                                                            \
        const T t = w->trace[l], n = w->norm2[l];                                                  \
        const T slope = MA(MA(t, t, -n), t, -2 * w->det[l]);                                       \
        const T over = 1 / slope;                                                                  \
        w->bad[l] = slope > (T)ROUND * t * t * t ? w->bad[l] : 1;                                  \
        w->k[0][l] = MA(t, t, n) * over;                                                           \
        w->k[1][l] = -2 * over;                                                                    \
        w->k[2][l] = 2 * t * over;                                                                 \
    }                                                                                              \
    for (l = 0; l < SFEMI_LANES; ++l) {                                                            \
        const T f0 = w->r[0][l], f1 = w->r[1][l], f2 = w->r[2][l];                                 \
        const T f3 = w->r[3][l], f4 = w->r[4][l], f5 = w->r[5][l];                                 \
        const T f6 = w->r[6][l], f7 = w->r[7][l], f8 = w->r[8][l];                                 \
        const T a = w->k[0][l], b = w->k[1][l];                                                    \
        w->s[0][l] = MA(b, DOT(f0, f0, f3, f3, f6, f6), a);                                        \
        w->s[1][l] = b * DOT(f0, f1, f3, f4, f6, f7);                                              \
        w->s[2][l] = b * DOT(f0, f2, f3, f5, f6, f8);                                              \
        w->s[3][l] = MA(b, DOT(f1, f1, f4, f4, f7, f7), a);                                        \
        w->s[4][l] = b * DOT(f1, f2, f4, f5, f7, f8);                                              \
        w->s[5][l] = MA(b, DOT(f2, f2, f5, f5, f8, f8), a);                                        \
    }                                                                                              \
    for (i = 0; i < 9; i += 3)                                                                     \
        for (l = 0; l < SFEMI_LANES; ++l) {                                                        \
            const T x = w->r[i][l], y = w->r[i + 1][l], z = w->r[i + 2][l], b = w->k[2][l];        \
            const T s0 = w->s[0][l], s1 = w->s[1][l], s2 = w->s[2][l];                             \
            const T s3 = w->s[3][l], s4 = w->s[4][l], s5 = w->s[5][l];                             \
            w->r[i][l] = MA(b, w->c[i][l], DOT(x, s0, y, s1, z, s2));                              \
            w->r[i + 1][l] = MA(b, w->c[i + 1][l], DOT(x, s1, y, s3, z, s4));                      \
            w->r[i + 2][l] = MA(b, w->c[i + 2][l], DOT(x, s2, y, s4, z, s5));                      \
        }                                                                                          \
}                                                                                                  \
                                                                                                   \
/* R as in sfemi_polar_fast, until the last step in every lane is below STEP t; lanes whose slope  \
 * is below ROUND t^3 are done again the slow way */                                               \
static SFEMI_INLINE void sfemi_lanes_polar_##S(sfemi_lanes_##S *w, const int fused)                \
{                                                                                                  \
    sfem_real g[9], r[9];                                                                          \
    int l, i, k;                                                                                   \
    sfemi_lanes_quartic_##S(w, fused);                                                             \
    for (k = 0; k < 8; ++k) {                                                                      \
        sfemi_lanes_halley_##S(w, fused);                                                          \
        if (!sfemi_lanes_any(w->bad, sizeof w->bad)) break;                                        \
    }                                                                                              \
    sfemi_lanes_rotation_##S(w, fused);                                                            \
    if (!sfemi_lanes_any(w->bad, sizeof w->bad)) return;                                           \
    for (l = 0; l < SFEMI_LANES; ++l) {                                                            \
        if (w->bad[l] == 0) continue;                                                              \
        for (i = 0; i < 9; ++i) g[i] = w->g[i][l];                                                 \
        sfemi_lanes_repair(g, sizeof(T) < sizeof g[0] ? SFEMI_TINY_F_MIXED : SFEMI_TINY_F, r);       \
        for (i = 0; i < 9; ++i) w->r[i][l] = (T)r[i];                                              \
    }                                                                                              \
}                                                                                                  \
                                                                                                   \
static SFEMI_INLINE void sfemi_lanes_linear_##S(sfemi_lanes_##S *w, const int fused)               \
{                                                                                                  \
    int l;                                                                                         \
    for (l = 0; l < SFEMI_LANES; ++l) {                                                            \
        const T e0 = w->g[0][l], e4 = w->g[4][l], e8 = w->g[8][l], trace = e0 + e4 + e8;           \
        const T e1 = w->g[1][l] + w->g[3][l], e2 = w->g[2][l] + w->g[6][l];                        \
        const T e5 = w->g[5][l] + w->g[7][l];                                                      \
        const T mu = w->mu[l], lt = w->lambda[l] * trace;                                          \
        w->p[0][l] = MA(2 * mu, e0, lt);                                                           \
        w->p[4][l] = MA(2 * mu, e4, lt);                                                           \
        w->p[8][l] = MA(2 * mu, e8, lt);                                                           \
        w->p[1][l] = w->p[3][l] = mu * e1;                                                         \
        w->p[2][l] = w->p[6][l] = mu * e2;                                                         \
        w->p[5][l] = w->p[7][l] = mu * e5;                                                         \
        w->energy[l] = MA(lt / 2, trace,                                                           \
                       mu * (DOT(e0, e0, e4, e4, e8, e8) + DOT(e1, e1, e2, e2, e5, e5) / 2));      \
    }                                                                                              \
}                                                                                                  \
                                                                                                   \
static SFEMI_INLINE void sfemi_lanes_corotational_##S(sfemi_lanes_##S *w, const int fused)         \
{                                                                                                  \
    int l, i;                                                                                      \
    for (l = 0; l < SFEMI_LANES; ++l) {                                                            \
        const T r0 = w->r[0][l], r1 = w->r[1][l], r2 = w->r[2][l];                                 \
        const T r3 = w->r[3][l], r4 = w->r[4][l], r5 = w->r[5][l];                                 \
        const T r6 = w->r[6][l], r7 = w->r[7][l], r8 = w->r[8][l];                                 \
        const T d0 = w->g[0][l] + (1 - r0), d1 = w->g[1][l] - r1, d2 = w->g[2][l] - r2;            \
        const T d3 = w->g[3][l] - r3, d4 = w->g[4][l] + (1 - r4), d5 = w->g[5][l] - r5;            \
        const T d6 = w->g[6][l] - r6, d7 = w->g[7][l] - r7, d8 = w->g[8][l] + (1 - r8);            \
        const T trace = DOT(r0, d0, r1, d1, r2, d2) + DOT(r3, d3, r4, d4, r5, d5) +                \
                        DOT(r6, d6, r7, d7, r8, d8);                                               \
        const T square = DOT(d0, d0, d1, d1, d2, d2) + DOT(d3, d3, d4, d4, d5, d5) +               \
                         DOT(d6, d6, d7, d7, d8, d8);                                              \
        const T lt = w->lambda[l] * trace;                                                         \
        w->trace[l] = lt;                                                                          \
        w->energy[l] = MA(w->mu[l], square, lt / 2 * trace);                                       \
    }                                                                                              \
    for (i = 0; i < 9; ++i) {                                                                      \
        const T one = i % 4 ? 0 : 1;                                                               \
        for (l = 0; l < SFEMI_LANES; ++l) {                                                        \
            const T r = w->r[i][l], d = w->g[i][l] + (one - r);                                    \
            w->p[i][l] = MA(2 * w->mu[l], d, w->trace[l] * r);                                     \
        }                                                                                          \
    }                                                                                              \
}                                                                                                  \
                                                                                                   \
static SFEMI_INLINE void sfemi_lanes_stvk_##S(sfemi_lanes_##S *w, const int fused)                 \
{                                                                                                  \
    int l;                                                                                         \
    for (l = 0; l < SFEMI_LANES; ++l) {                                                            \
        const T g0 = w->g[0][l], g1 = w->g[1][l], g2 = w->g[2][l];                                 \
        const T g3 = w->g[3][l], g4 = w->g[4][l], g5 = w->g[5][l];                                 \
        const T g6 = w->g[6][l], g7 = w->g[7][l], g8 = w->g[8][l];                                 \
        const T e0 = g0 + DOT(g0, g0, g3, g3, g6, g6) / 2;                                         \
        const T e4 = g4 + DOT(g1, g1, g4, g4, g7, g7) / 2;                                         \
        const T e8 = g8 + DOT(g2, g2, g5, g5, g8, g8) / 2;                                         \
        const T e1 = g1 + g3 + DOT(g0, g1, g3, g4, g6, g7);                                        \
        const T e2 = g2 + g6 + DOT(g0, g2, g3, g5, g6, g8);                                        \
        const T e5 = g5 + g7 + DOT(g1, g2, g4, g5, g7, g8);                                        \
        const T mu = w->mu[l], trace = e0 + e4 + e8, lt = w->lambda[l] * trace;                    \
        const T s0 = MA(2 * mu, e0, lt), s4 = MA(2 * mu, e4, lt);                                  \
        const T s8 = MA(2 * mu, e8, lt), s1 = mu * e1, s2 = mu * e2, s5 = mu * e5;                 \
        w->p[0][l] = s0 + DOT(g0, s0, g1, s1, g2, s2);                                             \
        w->p[1][l] = s1 + DOT(g0, s1, g1, s4, g2, s5);                                             \
        w->p[2][l] = s2 + DOT(g0, s2, g1, s5, g2, s8);                                             \
        w->p[3][l] = s1 + DOT(g3, s0, g4, s1, g5, s2);                                             \
        w->p[4][l] = s4 + DOT(g3, s1, g4, s4, g5, s5);                                             \
        w->p[5][l] = s5 + DOT(g3, s2, g4, s5, g5, s8);                                             \
        w->p[6][l] = s2 + DOT(g6, s0, g7, s1, g8, s2);                                             \
        w->p[7][l] = s5 + DOT(g6, s1, g7, s4, g8, s5);                                             \
        w->p[8][l] = s8 + DOT(g6, s2, g7, s5, g8, s8);                                             \
        w->energy[l] = MA(lt / 2, trace,                                                           \
                       mu * (DOT(e0, e0, e4, e4, e8, e8) + DOT(e1, e1, e2, e2, e5, e5) / 2));      \
    }                                                                                              \
}                                                                                                  \
                                                                                                   \
/* as sfemi_law_neohookean; k1 = 3/4 m, k2 = m i/(16 + 4 i) */                                     \
static SFEMI_INLINE void sfemi_lanes_neohookean_##S(sfemi_lanes_##S *w, const int fused)           \
{                                                                                                  \
    int l;                                                                                         \
    for (l = 0; l < SFEMI_LANES; ++l) {                                                            \
        const T g0 = w->g[0][l], g1 = w->g[1][l], g2 = w->g[2][l];                                 \
        const T g3 = w->g[3][l], g4 = w->g[4][l], g5 = w->g[5][l];                                 \
        const T g6 = w->g[6][l], g7 = w->g[7][l], g8 = w->g[8][l];                                 \
        const T c0 = DET(g4, g8, g5, g7), c1 = DET(g5, g6, g3, g8);                                \
        const T c2 = DET(g3, g7, g4, g6), c3 = DET(g2, g7, g1, g8);                                \
        const T c4 = DET(g0, g8, g2, g6), c5 = DET(g1, g6, g0, g7);                                \
        const T c6 = DET(g1, g5, g2, g4), c7 = DET(g2, g3, g0, g5);                                \
        const T c8 = DET(g0, g4, g1, g3);                                                          \
        const T trace = g0 + g4 + g8;                                                              \
        const T i = 2 * trace + DOT(g0, g0, g1, g1, g2, g2) +                                      \
                    DOT(g3, g3, g4, g4, g5, g5) + DOT(g6, g6, g7, g7, g8, g8);                     \
        const T j = trace + (c0 + c4 + c8) + DOT(g0, c0, g1, c1, g2, c2);                          \
        const T k1 = w->mu[l], lambda = w->lambda[l] + 5 * k1 / 6, k2 = k1 * i / (12 + 3 * i);     \
        const T a = k1 + k2, b = MA(lambda, j, -k1), lj = lambda * j;                              \
        w->p[0][l] = k1 * (g0 + g0 - c0 - trace) + MA(k2, g0 + 1, lj * (1 + c0 + trace - g0));     \
        w->p[4][l] = k1 * (g4 + g4 - c4 - trace) + MA(k2, g4 + 1, lj * (1 + c4 + trace - g4));     \
        w->p[8][l] = k1 * (g8 + g8 - c8 - trace) + MA(k2, g8 + 1, lj * (1 + c8 + trace - g8));     \
        w->p[1][l] = MA(a, g1, b * (c1 - g3));                                                     \
        w->p[2][l] = MA(a, g2, b * (c2 - g6));                                                     \
        w->p[3][l] = MA(a, g3, b * (c3 - g1));                                                     \
        w->p[5][l] = MA(a, g5, b * (c5 - g7));                                                     \
        w->p[6][l] = MA(a, g6, b * (c6 - g2));                                                     \
        w->p[7][l] = MA(a, g7, b * (c7 - g5));                                                     \
        w->trace[l] = i / 4;                                                                       \
        w->energy[l] = MA(lj / 2, j, k1 * 2 / 3 * (i - (T)1.5 * j));                               \
    }                                                                                              \
    for (l = 0; l < SFEMI_LANES; ++l)                                                              \
        w->energy[l] -= w->mu[l] * 2 / 3 * (T)log1p((double)w->trace[l]);                          \
}                                                                                                  \
                                                                                                   \
/* the forces p g_a on nodes 1, 2, 3 */                                                            \
static SFEMI_INLINE void sfemi_lanes_forces_##S(sfemi_lanes_##S *w, const sfemi_block *block,      \
                                                const int fused)                                   \
{                                                                                                  \
    int l, a;                                                                                      \
    for (a = 0; a < 9; a += 3)                                                                     \
        for (l = 0; l < SFEMI_LANES; ++l) {                                                        \
            const T x = (T)block->shape[a][l], y = (T)block->shape[a + 1][l];                      \
            const T z = (T)block->shape[a + 2][l];                                                 \
            w->d[a][l] = DOT(w->p[0][l], x, w->p[1][l], y, w->p[2][l], z);                         \
            w->d[a + 1][l] = DOT(w->p[3][l], x, w->p[4][l], y, w->p[5][l], z);                     \
            w->d[a + 2][l] = DOT(w->p[6][l], x, w->p[7][l], y, w->p[8][l], z);                     \
        }                                                                                          \
}                                                                                                  \
                                                                                                   \
static SFEMI_INLINE void sfemi_lanes_blocks_##S(const sfemi_block *block, sfem_int count,          \
                                                const sfem_real *u, sfem_real *out, sfem_real *rotation,\
                                                sfemi_totals *totals, const sfemi_gather gather,   \
                                                const sfemi_scatter scatter, const int fused)      \
{                                                                                                  \
    sfemi_totals sum;                                                                              \
    sfemi_lanes_##S w;                                                                             \
    int l, i;                                                                                      \
    memset(&sum, 0, sizeof sum);                                                                   \
    for (; count > 0; --count, ++block) {                                                          \
        gather(block, u, w.d);                                                                     \
        sfemi_lanes_deform_##S(&w, block, fused);                                                  \
        if (block->law == SFEM_COROTATIONAL || (rotation && block->law != SFEM_LINEAR))            \
            sfemi_lanes_polar_##S(&w, fused);                                                      \
        switch (block->law) {                                                                      \
        case SFEM_COROTATIONAL: sfemi_lanes_corotational_##S(&w, fused); break;                    \
        case SFEM_STVK: sfemi_lanes_stvk_##S(&w, fused); break;                                    \
        case SFEM_NEOHOOKEAN: sfemi_lanes_neohookean_##S(&w, fused); break;                        \
        default: sfemi_lanes_linear_##S(&w, fused);                                                \
        }                                                                                          \
        sfemi_lanes_forces_##S(&w, block, fused);                                                  \
        scatter(block, (const sfem_real(*)[SFEMI_LANES])w.d, out);                                 \
        for (l = 0; l < SFEMI_LANES; ++l) {                                                        \
            sum.energy[l] += w.energy[l];                                                          \
            sum.inverted[l] += w.mu[l] > 0 && w.det[l] <= 0 ? 1 : 0;                               \
        }                                                                                          \
        for (l = 0; rotation && l < block->count; ++l) {                                           \
            for (i = 0; i < 9; ++i)                                                                \
                rotation[9 * (size_t)block->tet[l] + (size_t)i] =                                  \
                    block->law == SFEM_LINEAR ? (sfem_real)(i % 4 == 0) : w.r[i][l];               \
        }                                                                                          \
    }                                                                                              \
    *totals = sum;                                                                                 \
}

SFEMI_LANE_KERNELS(double, d, SFEMI_MA_d, SFEMI_DOT_d, SFEMI_DET_d, 2e-6, 3e-2)
SFEMI_LANE_KERNELS(float, f, SFEMI_MA_f, SFEMI_DOT_f, SFEMI_DET_f, 2e-3, 6e-2)

#define SFEMI_BLOCKS_KERNEL(NAME, S, PATH, FUSED, TARGET)                                          \
TARGET static void NAME(const sfemi_block *block, sfem_int count, const sfem_real *u,              \
                        sfem_real *out, sfem_real *rotation, sfemi_totals *totals)                 \
{                                                                                                  \
    sfemi_lanes_blocks_##S(block, count, u, out, rotation, totals, sfemi_gather_##PATH,            \
                           sfemi_scatter_##PATH, FUSED);                                           \
}

SFEMI_BLOCKS_KERNEL(sfemi_blocks_portable_d, d, portable, 0, )
SFEMI_BLOCKS_KERNEL(sfemi_blocks_portable_f, f, portable, 0, )
#if SFEMI_X86
SFEMI_BLOCKS_KERNEL(sfemi_blocks_avx2_d, d, avx2, 1, SFEMI_AVX2)
SFEMI_BLOCKS_KERNEL(sfemi_blocks_avx2_f, f, avx2, 1, SFEMI_AVX2)
SFEMI_BLOCKS_KERNEL(sfemi_blocks_avx512_d, d, avx2, 1, SFEMI_AVX512)
SFEMI_BLOCKS_KERNEL(sfemi_blocks_avx512_f, f, avx2, 1, SFEMI_AVX512)
#endif

/* The widest path that this processor has. */
static sfemi_blocks_kernel sfemi_blocks_pick(sfem_precision precision)
{
    const int mixed = precision == SFEM_MIXED;
#if SFEMI_X86
    switch (sfemi_path()) {
    case 2: return mixed ? sfemi_blocks_avx512_f : sfemi_blocks_avx512_d;
    case 1: return mixed ? sfemi_blocks_avx2_f : sfemi_blocks_avx2_d;
    default: break;
    }
#endif
    return mixed ? sfemi_blocks_portable_f : sfemi_blocks_portable_d;
}

/* ============================================================================================
 * >>fem   assembly, mass, damping, forces, tangents, loads, stress
 *
 * K, D and a consistent M live on one pattern: the node graph, lower half by rows. M is a scalar a
 * block (M_ij I), or a scalar a node when lumped.  D = alpha M + beta K + damping.
 * ============================================================================================ */

/* ---- chunks: how forces and tangents are computed on any number of threads ----
 *
 * Tets in their order make chunks; a chunk computes with copies of its nodes' displacements and
 * adds into copies of their forces, which are then added up node by node. What a chunk does and
 * the order of every sum are fixed by the mesh. For tangents, chunks without a common node have
 * one colour and add into the matrix at the same time. */
#define SFEMI_CHUNK_TETS 256
#define SFEMI_CHUNK_TASK 4     /* chunks a task */
#define SFEMI_NODE_TASK  2048  /* nodes a task */

typedef struct sfemi_chunks {
    sfem_int count, copies, colors;
    sfemi_block *block;
    sfem_int *block_start;  /* [count+1] blocks of a chunk */
    sfem_int *copy_start;   /* [count+1] copies of a chunk */
    sfem_int *copy_node;    /* [copies] */
    sfem_int *node_start;   /* [nodes+1] copies of a node, */
    sfem_int *node_copy;    /* [copies] in ascending order */
    sfem_int *color_start;  /* [colors+1] chunks of a colour, */
    sfem_int *color_chunk;  /* [count] */
    sfem_int *place;        /* [tets][10] where in K's pattern the blocks of nodes a >= b go */
} sfemi_chunks;

typedef struct sfem_factor sfem_factor;

struct sfem_model {
    sfem_allocator allocator;
    sfem_mesh mesh;
    sfem_mass mass;
    sfem_matrix stiffness;
    sfem_matrix_upper upper;   /* always there, so that no number of threads changes a sum */
    sfem_int *row, *col;       /* the pattern, [nodes+1], [blocks] */
    sfem_real *node_mass;      /* [nodes] row sums of M; 0 at a node that is in no tet */
    sfem_real *block_mass;     /* [blocks] consistent M, or NULL */
    sfem_real *damping;        /* [blocks][3][3] what alpha and beta leave of D, or NULL */
    sfem_real alpha, beta;     /* Rayleigh damping that all tets share */
    sfem_real *lambda, *mu;    /* [tets] Lame's parameters, Pa */
    sfem_real *density;        /* [tets] kg/m^3 */
    sfem_real *volume;         /* [tets] */
    unsigned char *law;        /* [tets] sfem_law */
    int turns, hardens;        /* some law is not linear; is neither linear nor corotational */
    sfemi_chunks chunks;
    sfem_real total_mass;
    int lock;                  /* guards what follows */
    sfem_int references;
    sfem_factor *factors;      /* those that bodies use now */
};

/* Sections this short need no more than a spin lock. */
static void sfemi_lock(int *lock)
{
#if defined(__GNUC__)
    while (__atomic_exchange_n(lock, 1, __ATOMIC_ACQUIRE)) continue;
#elif defined(_MSC_VER)
    while (_InterlockedExchange((volatile long *)lock, 1)) continue;
#else
    *lock = 1;
#endif
}

static void sfemi_unlock(int *lock)
{
#if defined(__GNUC__)
    __atomic_store_n(lock, 0, __ATOMIC_RELEASE);
#elif defined(_MSC_VER)
    _InterlockedExchange((volatile long *)lock, 0);
#else
    *lock = 0;
#endif
}

SFEM_DEF sfem_material sfem_default_material(void)
{
    sfem_material m;
    m.young = 1e6;
    m.poisson = 0.3;
    m.density = 1000;
    m.alpha = m.beta = 0;
    m.law = SFEM_LINEAR;
    return m;
}

SFEM_DEF sfem_model_def sfem_default_model_def(void)
{
    sfem_model_def d;
    memset(&d, 0, sizeof d);
    d.material = sfem_default_material();
    d.mass = SFEM_MASS_LUMPED;
    return d;
}

static sfem_status sfemi_fem_check_material(const sfem_material *m, sfem_int index, sfem_error *err)
{
    if (!(sfemi_finite(m->young) && m->young > 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "material %d: Young's modulus is %g Pa, must be > 0",
                          (int)index, m->young);
    if (!(sfemi_finite(m->poisson) && m->poisson > -1 && m->poisson < 0.5))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT,
                          "material %d: Poisson's ratio is %g, must lie in (-1, 0.5)", (int)index,
                          m->poisson);
    if (!(sfemi_finite(m->density) && m->density > 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "material %d: density is %g kg/m^3, must be > 0",
                          (int)index, m->density);
    if (!(sfemi_finite(m->alpha) && m->alpha >= 0 && sfemi_finite(m->beta) && m->beta >= 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "material %d: damping (%g, %g) must be >= 0",
                          (int)index, m->alpha, m->beta);
    if ((unsigned)m->law > SFEM_NEOHOOKEAN)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "material %d: there is no law %d", (int)index,
                          (int)m->law);
    return SFEM_OK;
}

/* Which of the definition's materials a tet has. */
static sfem_int sfemi_fem_material_of(const sfem_model_def *def, sfem_int tet)
{
    if (!def->materials) return 0;
    if (def->tet_material) return def->tet_material[tet];
    return def->mesh->region ? def->mesh->region[tet] : 0;
}

static sfem_status sfemi_fem_check(const sfem_model_def *def, sfem_error *err)
{
    const sfem_int count = def->materials ? def->material_count : 1;
    sfem_status status;
    sfem_int i;
    status = sfem_mesh_check(def->mesh, NULL, err);
    if (status != SFEM_OK) return status;
    if (count < 1) return sfemi_fail(err, SFEM_BAD_ARGUMENT, "material_count is %d", (int)count);
    for (i = 0; i < count; ++i) {
        status = sfemi_fem_check_material(def->materials ? def->materials + i : &def->material, i, err);
        if (status != SFEM_OK) return status;
    }
    for (i = 0; i < def->mesh->tets; ++i) {
        const sfem_int m = sfemi_fem_material_of(def, i);
        if (m < 0 || m >= count)
            return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, -1, i,
                                 "tet %d has material %d, there are %d", (int)i, (int)m, (int)count);
    }
    return SFEM_OK;
}

/* Counts (col NULL) or fills the lower-half pattern of the node graph: for each node, the nodes j <= i
 * of its tets. start/list: tets of each node; mark [nodes]: last row that saw a node. */
static sfem_int sfemi_fem_pattern_row(const sfem_mesh *mesh, const sfem_int *start,
                                      const sfem_int *list, sfem_int i, sfem_int *mark, sfem_int *out)
{
    sfem_int count = 0, k, a;
    mark[i] = i;
    for (k = start[i]; k < start[i + 1]; ++k) {
        const sfem_int *t = mesh->tet + 4 * (size_t)list[k];
        for (a = 0; a < 4; ++a) {
            sfem_int at = count;
            if (t[a] >= i || mark[t[a]] == i) continue;
            mark[t[a]] = i;
            ++count;
            if (!out) continue;
            for (; at > 0 && out[at - 1] > t[a]; --at) out[at] = out[at - 1];
            out[at] = t[a];
        }
    }
    if (out) out[count] = i;
    return count + 1;
}

static sfem_status sfemi_fem_pattern(sfem_model *model, sfem_error *err)
{
    const sfem_mesh *mesh = &model->mesh;
    const sfem_allocator *al = &model->allocator;
    sfem_int *start = NULL, *list = NULL, *mark = NULL, i, a, e;
    sfem_status status = SFEM_OK;
    if (mesh->tets > INT32_MAX / 10)
        return sfemi_fail(err, SFEM_TOO_LARGE, "%d tets overflow the index type", (int)mesh->tets);
    SFEMI_NEW(sfem_int, start, al, (size_t)mesh->nodes + 2);
    SFEMI_NEW(sfem_int, list, al, 4 * (size_t)mesh->tets);
    SFEMI_NEW(sfem_int, mark, al, mesh->nodes);
    SFEMI_NEW(sfem_int, model->row, al, (size_t)mesh->nodes + 1);
    for (i = 0; i < 4 * mesh->tets; ++i) ++start[mesh->tet[i] + 2];
    for (i = 0; i < mesh->nodes; ++i) start[i + 2] += start[i + 1];
    for (e = 0; e < mesh->tets; ++e)
        for (a = 0; a < 4; ++a) list[start[mesh->tet[4 * e + a] + 1]++] = e;
    for (i = 0; i < mesh->nodes; ++i) mark[i] = -1;
    for (i = 0; i < mesh->nodes; ++i)
        model->row[i + 1] = model->row[i] + sfemi_fem_pattern_row(mesh, start, list, i, mark, NULL);
    SFEMI_NEW(sfem_int, model->col, al, model->row[mesh->nodes]);
    for (i = 0; i < mesh->nodes; ++i) mark[i] = -1;
    for (i = 0; i < mesh->nodes; ++i)
        sfemi_fem_pattern_row(mesh, start, list, i, mark, model->col + model->row[i]);
done:
    sfemi_delete(al, mark);
    sfemi_delete(al, list);
    sfemi_delete(al, start);
    return status;
}

/* The place of block (i, j), i >= j, in the pattern; -1 if it is not there. */
static sfem_int sfemi_fem_find(const sfem_int *row, const sfem_int *col, sfem_int i, sfem_int j)
{
    sfem_int low = row[i], high = row[i + 1] - 1;
    while (low < high) {
        const sfem_int mid = low + (high - low) / 2;
        if (col[mid] < j) low = mid + 1;
        else high = mid;
    }
    return col[low] == j ? low : -1;
}

static void sfemi_chunks_free(sfemi_chunks *c, const sfem_allocator *al)
{
    sfemi_delete(al, c->block);
    sfemi_delete(al, c->block_start);
    sfemi_delete(al, c->copy_start);
    sfemi_delete(al, c->copy_node);
    sfemi_delete(al, c->node_start);
    sfemi_delete(al, c->node_copy);
    sfemi_delete(al, c->color_start);
    sfemi_delete(al, c->color_chunk);
    sfemi_delete(al, c->place);
}

/* Counts blocks and copies by chunk. mark [nodes] is -1. */
static void sfemi_chunks_count(const sfem_model *model, sfemi_chunks *c, sfem_int *mark)
{
    const sfem_mesh *mesh = &model->mesh;
    sfem_int k, e, a, law, laws[SFEM_NEOHOOKEAN + 1];
    for (k = 0; k < c->count; ++k) {
        const sfem_int end = k + 1 < c->count ? (k + 1) * SFEMI_CHUNK_TETS : mesh->tets;
        memset(laws, 0, sizeof laws);
        c->copy_start[k + 1] = c->copy_start[k];
        c->block_start[k + 1] = c->block_start[k];
        for (e = k * SFEMI_CHUNK_TETS; e < end; ++e) {
            ++laws[model->law[e]];
            for (a = 0; a < 4; ++a) {
                const sfem_int node = mesh->tet[4 * (size_t)e + (size_t)a];
                c->copy_start[k + 1] += mark[node] != k;
                mark[node] = k;
            }
        }
        for (law = 0; law <= SFEM_NEOHOOKEAN; ++law)
            c->block_start[k + 1] += (laws[law] + SFEMI_LANES - 1) / SFEMI_LANES;
    }
    c->copies = c->copy_start[c->count];
}

/* Puts tet e, or a copy of it without stiffness, into a lane. local: a node's number in the
 * chunk. */
static void sfemi_chunks_fill(const sfem_model *model, sfem_int e, int filler,
                              const sfem_int *local, sfemi_block *block, sfem_int lane)
{
    const sfem_int *t = model->mesh.tet + 4 * (size_t)e;
    sfem_real g[4][3];
    int i;
    sfemi_element_gradients(&model->mesh, e, g);
    for (i = 0; i < 9; ++i) block->shape[i][lane] = g[1 + i / 3][i % 3];
    for (i = 0; i < 4; ++i) block->node[i][lane] = 4 * local[t[i]];
    block->lambda[lane] = filler ? 0 : model->volume[e] * model->lambda[e];
    block->mu[lane] = filler ? 0 : model->volume[e] * model->mu[e];
    block->tet[lane] = e;
    if (!filler) block->count = lane + 1;
}

/* The blocks of chunk k, law by law. Neighbours go to the same lane of different blocks: lane
 * after lane then adds to different nodes, and need not wait for the last sum. */
static void sfemi_chunks_fill_blocks(const sfem_model *model, sfemi_chunks *c, sfem_int k,
                                     const sfem_int *local)
{
    const sfem_int first = k * SFEMI_CHUNK_TETS;
    const sfem_int end = k + 1 < c->count ? first + SFEMI_CHUNK_TETS : model->mesh.tets;
    sfemi_block *block = c->block + c->block_start[k];
    sfem_int law, e, b, lane, blocks, tets, last = first;
    for (law = 0; law <= SFEM_NEOHOOKEAN; ++law) {
        for (e = first, tets = 0; e < end; ++e) tets += model->law[e] == law;
        blocks = (tets + SFEMI_LANES - 1) / SFEMI_LANES;
        for (e = first, b = lane = 0; tets > 0 && lane < SFEMI_LANES; ++e) {
            if (e < end && model->law[e] != law) continue;
            if (e < end) last = e; /* then the lanes that are left */
            sfemi_chunks_fill(model, last, e >= end, local, block + b, lane);
            block[b].law = law;
            if (++b == blocks) b = 0, ++lane;
        }
        block += blocks;
    }
}

/* Copies and blocks, and the copies of each node. mark and local [nodes]; mark is -1. */
static void sfemi_chunks_number(const sfem_model *model, sfemi_chunks *c, sfem_int *mark,
                                sfem_int *local)
{
    const sfem_mesh *mesh = &model->mesh;
    sfem_int k, i, copy = 0;
    for (k = 0; k < c->count; ++k) {
        const size_t end = 4 * (size_t)(k + 1 < c->count ? (k + 1) * SFEMI_CHUNK_TETS : mesh->tets);
        size_t at;
        for (at = 4 * (size_t)k * SFEMI_CHUNK_TETS; at < end; ++at) {
            const sfem_int node = mesh->tet[at];
            if (mark[node] == k) continue;
            mark[node] = k;
            local[node] = copy - c->copy_start[k];
            c->copy_node[copy++] = node;
        }
        sfemi_chunks_fill_blocks(model, c, k, local);
    }
    for (i = 0; i < c->copies; ++i) ++c->node_start[c->copy_node[i] + 1];
    for (i = 0; i < mesh->nodes; ++i) {
        c->node_start[i + 1] += c->node_start[i];
        local[i] = c->node_start[i];
    }
    for (i = 0; i < c->copies; ++i) c->node_copy[local[c->copy_node[i]]++] = i;
}

/* The chunk that a copy belongs to. */
static sfem_int sfemi_chunks_of(const sfemi_chunks *c, sfem_int copy)
{
    sfem_int low = 0, high = c->count;
    while (high - low > 1) {
        const sfem_int mid = low + (high - low) / 2;
        if (c->copy_start[mid] <= copy)
            low = mid;
        else
            high = mid;
    }
    return low;
}

/* Greedy colours, and the chunks by colour. color, mark [chunks+1]. */
static void sfemi_chunks_color(sfemi_chunks *c, sfem_int *color, sfem_int *mark)
{
    sfem_int k, i, j, n;
    for (k = 0; k < c->count; ++k) mark[k] = color[k] = -1;
    for (k = 0; k < c->count; ++k) {
        for (i = c->copy_start[k]; i < c->copy_start[k + 1]; ++i)
            for (j = c->node_start[c->copy_node[i]]; j < c->node_start[c->copy_node[i] + 1]; ++j) {
                const sfem_int other = sfemi_chunks_of(c, c->node_copy[j]);
                if (other >= k) break;
                mark[color[other]] = k;
            }
        for (n = 0; n < k && mark[n] == k; ++n) continue;
        color[k] = n;
        if (n >= c->colors) c->colors = n + 1;
        ++c->color_start[n + 1];
    }
    for (n = 0; n < c->colors; ++n) {
        c->color_start[n + 1] += c->color_start[n];
        for (k = 0, i = c->color_start[n]; k < c->count; ++k)
            if (color[k] == n) c->color_chunk[i++] = k;
    }
}

static sfem_status sfemi_chunks_build(sfem_model *model, sfem_error *err)
{
    const sfem_allocator *al = &model->allocator;
    const sfem_mesh *mesh = &model->mesh;
    sfemi_chunks *c = &model->chunks;
    sfem_int *mark = NULL, *local = NULL;
    sfem_status status = SFEM_OK;
    c->count = (mesh->tets + SFEMI_CHUNK_TETS - 1) / SFEMI_CHUNK_TETS;
    SFEMI_NEW(sfem_int, mark, al, (size_t)mesh->nodes + (size_t)c->count);
    SFEMI_NEW(sfem_int, local, al, (size_t)mesh->nodes + (size_t)c->count);
    SFEMI_NEW(sfem_int, c->block_start, al, (size_t)c->count + 1);
    SFEMI_NEW(sfem_int, c->copy_start, al, (size_t)c->count + 1);
    SFEMI_NEW(sfem_int, c->color_start, al, (size_t)c->count + 1);
    SFEMI_NEW(sfem_int, c->color_chunk, al, c->count);
    SFEMI_NEW(sfem_int, c->node_start, al, (size_t)mesh->nodes + 1);
    memset(mark, -1, (size_t)mesh->nodes * sizeof *mark);
    sfemi_chunks_count(model, c, mark);
    SFEMI_NEW(sfemi_block, c->block, al, c->block_start[c->count]);
    SFEMI_NEW(sfem_int, c->copy_node, al, c->copies);
    SFEMI_NEW(sfem_int, c->node_copy, al, c->copies);
    memset(mark, -1, (size_t)mesh->nodes * sizeof *mark);
    sfemi_chunks_number(model, c, mark, local);
    sfemi_chunks_color(c, local, mark);
done:
    sfemi_delete(al, mark);
    sfemi_delete(al, local);
    return status;
}

/* Adds tet e to K, M and the part of D that is its own: alpha_e - alpha, beta_e - beta. */
static void sfemi_fem_add_tet(sfem_model *model, sfem_int e, const sfem_material *m)
{
    const sfem_int *t = model->mesh.tet + 4 * (size_t)e;
    sfem_int *place = model->chunks.place + 10 * (size_t)e;
    const sfem_real da = m->alpha - model->alpha, db = m->beta - model->beta;
    sfem_real g[4][3], k[9], node;
    int a, b, i;
    const sfem_real v = model->volume[e] = sfemi_element_gradients(&model->mesh, e, g);
    sfem_law_lame(m->young, m->poisson, &model->lambda[e], &model->mu[e]);
    model->law[e] = (unsigned char)m->law;
    model->turns |= m->law != SFEM_LINEAR;
    model->hardens |= m->law == SFEM_STVK || m->law == SFEM_NEOHOOKEAN;
    model->density[e] = m->density;
    node = m->density * v / 20;
    for (a = 0; a < 4; ++a) {
        model->node_mass[t[a]] += 5 * node;
        for (b = 0; b < 4; ++b) {
            sfem_int at;
            sfem_real *d, *kk;
            if (t[a] < t[b]) continue;
            at = sfemi_fem_find(model->row, model->col, t[a], t[b]);
            place[a > b ? a * (a + 1) / 2 + b : b * (b + 1) / 2 + a] = at;
            kk = model->stiffness.val + 9 * (size_t)at;
            sfemi_element_block(g[a], g[b], v * model->lambda[e], v * model->mu[e], k);
            for (i = 0; i < 9; ++i) kk[i] += k[i];
            if (model->block_mass) model->block_mass[at] += a == b ? 2 * node : node;
            if (!model->damping) continue;
            d = model->damping + 9 * (size_t)at;
            for (i = 0; i < 9; ++i) d[i] += db * k[i];
            for (i = 0; i < 9; i += 4)
                d[i] += da * (model->block_mass ? (a == b ? 2 * node : node) : a == b ? 5 * node : 0);
        }
    }
}

static int sfemi_fem_damping_varies(const sfem_model_def *def)
{
    sfem_int i;
    for (i = 1; def->materials && i < def->material_count; ++i)
        if (def->materials[i].alpha != def->materials[0].alpha ||
            def->materials[i].beta != def->materials[0].beta)
            return 1;
    return 0;
}

static sfem_status sfemi_fem_add_damping(sfem_model *model, const sfem_matrix *d, sfem_error *err)
{
    sfem_int i, k, j;
    if (d->n != model->mesh.nodes)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT,
                          "the damping matrix has %d block rows, the mesh %d nodes", (int)d->n,
                          (int)model->mesh.nodes);
    for (i = 0; i < d->n; ++i) {
        for (k = d->row[i]; k < d->row[i + 1]; ++k) {
            const sfem_int at = sfemi_fem_find(model->row, model->col, i, d->col[k]);
            if (at < 0)
                return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, i, -1,
                                     "damping block (%d, %d) is outside the pattern of K", (int)i,
                                     (int)d->col[k]);
            if (!sfemi_all_finite(d->val + 9 * (size_t)k, 9))
                return sfemi_fail_at(err, SFEM_NOT_FINITE, i, -1, "damping block (%d, %d) is not finite",
                                     (int)i, (int)d->col[k]);
            for (j = 0; j < 9; ++j)
                model->damping[9 * (size_t)at + (size_t)j] += d->val[9 * (size_t)k + (size_t)j];
        }
    }
    return SFEM_OK;
}

static void sfemi_fem_destroy(sfem_model *model)
{
    const sfem_allocator al = model->allocator;
    sfem_mesh_free(&model->mesh);
    sfem_matrix_upper_free(&model->upper);
    sfemi_delete(&al, model->row);
    sfemi_delete(&al, model->col);
    sfemi_delete(&al, model->stiffness.val);
    sfemi_delete(&al, model->node_mass);
    sfemi_delete(&al, model->block_mass);
    sfemi_delete(&al, model->damping);
    sfemi_delete(&al, model->lambda);
    sfemi_delete(&al, model->mu);
    sfemi_delete(&al, model->density);
    sfemi_delete(&al, model->volume);
    sfemi_delete(&al, model->law);
    sfemi_chunks_free(&model->chunks, &al);
    sfemi_delete(&al, model);
}

static sfem_status sfemi_fem_allocate(sfem_model *model, const sfem_model_def *def, sfem_error *err)
{
    const sfem_allocator *al = &model->allocator;
    const sfem_mesh *mesh = def->mesh;
    sfem_status status = SFEM_OK;
    size_t blocks;
    model->mesh.allocator = *al; /* a plain copy: sfemi_fem_check has seen it */
    model->mesh.nodes = mesh->nodes;
    model->mesh.tets = mesh->tets;
    SFEMI_NEW(sfem_real, model->mesh.x, al, 3 * (size_t)mesh->nodes);
    SFEMI_NEW(sfem_int, model->mesh.tet, al, 4 * (size_t)mesh->tets);
    memcpy(model->mesh.x, mesh->x, 3 * (size_t)mesh->nodes * sizeof *mesh->x);
    memcpy(model->mesh.tet, mesh->tet, 4 * (size_t)mesh->tets * sizeof *mesh->tet);
    if (mesh->region) {
        SFEMI_NEW(sfem_int, model->mesh.region, al, mesh->tets);
        memcpy(model->mesh.region, mesh->region, (size_t)mesh->tets * sizeof *mesh->region);
    }
    SFEMI_TRY(sfemi_fem_pattern(model, err));
    blocks = (size_t)model->row[mesh->nodes];
    SFEMI_NEW(sfem_real, model->stiffness.val, al, 9 * blocks);
    SFEMI_NEW(sfem_real, model->node_mass, al, mesh->nodes);
    SFEMI_NEW(sfem_real, model->lambda, al, mesh->tets);
    SFEMI_NEW(sfem_real, model->mu, al, mesh->tets);
    SFEMI_NEW(sfem_real, model->density, al, mesh->tets);
    SFEMI_NEW(sfem_real, model->volume, al, mesh->tets);
    SFEMI_NEW(unsigned char, model->law, al, mesh->tets);
    SFEMI_NEW(sfem_int, model->chunks.place, al, 10 * (size_t)mesh->tets);
    if (def->mass == SFEM_MASS_CONSISTENT) SFEMI_NEW(sfem_real, model->block_mass, al, blocks);
    if (def->damping || sfemi_fem_damping_varies(def))
        SFEMI_NEW(sfem_real, model->damping, al, 9 * blocks);
    model->stiffness.n = mesh->nodes;
    model->stiffness.row = model->row;
    model->stiffness.col = model->col;
    SFEMI_TRY(sfem_matrix_upper_create(&model->stiffness, al, &model->upper, err));
    model->stiffness.upper = &model->upper;
done:
    return status;
}

SFEM_DEF sfem_status sfem_model_create(const sfem_model_def *def, sfem_model **out, sfem_error *err)
{
    const sfem_material *materials;
    sfem_model *model = NULL;
    sfem_status status;
    sfem_int i;
    SFEM_ASSERT(def && out && def->mesh);
    materials = def->materials ? def->materials : &def->material;
    SFEMI_TRY(sfemi_fem_check(def, err));
    SFEMI_NEW(sfem_model, model, &def->allocator, 1);
    model->allocator = def->allocator;
    model->references = 1;
    model->mass = def->mass;
    SFEMI_TRY(sfemi_fem_allocate(model, def, err));
    if (!sfemi_fem_damping_varies(def)) {
        model->alpha = materials->alpha;
        model->beta = materials->beta;
    }
    for (i = 0; i < model->mesh.tets; ++i)
        sfemi_fem_add_tet(model, i, materials + sfemi_fem_material_of(def, i));
    SFEMI_TRY(sfemi_chunks_build(model, err));
    for (i = 0; i < model->mesh.nodes; ++i) model->total_mass += model->node_mass[i];
    if (def->damping) SFEMI_TRY(sfemi_fem_add_damping(model, def->damping, err));
    if (!sfemi_all_finite(model->stiffness.val, 9 * (size_t)model->row[model->mesh.nodes])) {
        status = sfemi_fail(err, SFEM_NOT_FINITE, "the stiffness matrix overflows: check the units");
        goto done;
    }
    *out = model;
    return SFEM_OK;
done:
    if (model) sfemi_fem_destroy(model);
    return status;
}

SFEM_DEF void sfem_model_free(sfem_model *model)
{
    sfem_int left;
    if (!model) return;
    sfemi_lock(&model->lock);
    left = --model->references;
    sfemi_unlock(&model->lock);
    if (left == 0) sfemi_fem_destroy(model);
}

SFEM_DEF const sfem_mesh *sfem_model_mesh(const sfem_model *model) { return &model->mesh; }
SFEM_DEF const sfem_matrix *sfem_model_stiffness(const sfem_model *model) { return &model->stiffness; }
SFEM_DEF const sfem_real *sfem_model_node_mass(const sfem_model *model) { return model->node_mass; }
SFEM_DEF const sfem_real *sfem_model_tet_volume(const sfem_model *model) { return model->volume; }
SFEM_DEF sfem_real sfem_model_total_mass(const sfem_model *model) { return model->total_mass; }

/* block = k K + m M + d D at place `at` of the pattern, (i, j) its row and column. D is resolved into
 * K, M and the rest by the caller: ck, cm, cd multiply K, M and model->damping. */
static void sfemi_fem_block(const sfem_model *model, sfem_int at, sfem_int i, sfem_real ck, sfem_real cm,
                            sfem_real cd, sfem_real block[9])
{
    const sfem_real *k = model->stiffness.val + 9 * (size_t)at;
    const sfem_real m = model->block_mass        ? model->block_mass[at]
                        : model->col[at] == i ? model->node_mass[i]
                                              : 0;
    int j;
    for (j = 0; j < 9; ++j) block[j] = ck * k[j];
    for (j = 0; j < 9; j += 4) block[j] += cm * m;
    if (model->damping && cd != 0)
        for (j = 0; j < 9; ++j) block[j] += cd * model->damping[9 * (size_t)at + (size_t)j];
}

/* Arrays of a matrix of the given size; on failure those made so far are in *a, to be freed. */
static sfem_status sfemi_fem_new_matrix(sfem_int n, size_t blocks, const sfem_allocator *al,
                                        sfem_int **row, sfem_int **col, sfem_matrix *a, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    memset(a, 0, sizeof *a);
    a->n = n;
    SFEMI_NEW(sfem_int, *row, al, (size_t)n + 1);
    a->row = *row;
    SFEMI_NEW(sfem_int, *col, al, blocks + 1);
    a->col = *col;
    SFEMI_NEW(sfem_real, a->val, al, 9 * blocks + 1);
done:
    return status;
}

SFEM_DEF sfem_status sfem_model_combine(const sfem_model *model, sfem_real k, sfem_real m, sfem_real d,
                                        const sfem_allocator *allocator, sfem_matrix *out,
                                        sfem_error *err)
{
    static const sfem_allocator standard = {0, 0, 0};
    const sfem_allocator *al = allocator ? allocator : &standard;
    const sfem_int n = model->mesh.nodes;
    sfem_int *row = NULL, *col = NULL, i, at;
    sfem_matrix a;
    sfem_status status = SFEM_OK;
    SFEMI_TRY(sfemi_fem_new_matrix(n, (size_t)model->row[n], al, &row, &col, &a, err));
    memcpy(row, model->row, ((size_t)n + 1) * sizeof *row);
    memcpy(col, model->col, (size_t)model->row[n] * sizeof *col);
    for (i = 0; i < n; ++i)
        for (at = row[i]; at < row[i + 1]; ++at)
            sfemi_fem_block(model, at, i, k + d * model->beta, m + d * model->alpha, d,
                            a.val + 9 * (size_t)at);
    *out = a;
    return SFEM_OK;
done:
    sfem_matrix_free(&a, al);
    return status;
}

SFEM_DEF void sfem_model_multiply_stiffness(const sfem_model *model, const sfem_real *x, sfem_real *y,
                                            const sfem_exec *exec)
{
    sfem_matrix_multiply(&model->stiffness, x, y, exec);
}

/* y += scale M x. */
static void sfemi_fem_add_mass(const sfem_model *model, sfem_real scale, const sfem_real *x,
                               sfem_real *y)
{
    sfem_int i, at;
    int c;
    for (i = 0; i < model->mesh.nodes; ++i) {
        const sfem_real *xi = x + 3 * (size_t)i;
        sfem_real *yi = y + 3 * (size_t)i;
        if (!model->block_mass) {
            for (c = 0; c < 3; ++c) yi[c] += scale * model->node_mass[i] * xi[c];
            continue;
        }
        for (at = model->row[i]; at < model->row[i + 1]; ++at) {
            const sfem_real m = scale * model->block_mass[at];
            const size_t j = 3 * (size_t)model->col[at];
            for (c = 0; c < 3; ++c) yi[c] += m * x[j + (size_t)c];
            if (model->col[at] == i) continue;
            for (c = 0; c < 3; ++c) y[j + (size_t)c] += m * xi[c];
        }
    }
}

SFEM_DEF void sfem_model_multiply_mass(const sfem_model *model, const sfem_real *x, sfem_real *y,
                                       const sfem_exec *exec)
{
    (void)exec;
    memset(y, 0, 3 * (size_t)model->mesh.nodes * sizeof *y);
    sfemi_fem_add_mass(model, 1, x, y);
}

/* y += the part of D x that is neither alpha M nor beta K. */
static void sfemi_fem_add_damping_rest(const sfem_model *model, const sfem_real *x, sfem_real *y)
{
    sfem_int i, at;
    int r, c;
    for (i = 0; model->damping && i < model->mesh.nodes; ++i) {
        const sfem_real *xi = x + 3 * (size_t)i;
        sfem_real *yi = y + 3 * (size_t)i;
        for (at = model->row[i]; at < model->row[i + 1]; ++at) {
            const sfem_real *d = model->damping + 9 * (size_t)at;
            const sfem_real *xj = x + 3 * (size_t)model->col[at];
            sfem_real *yj = y + 3 * (size_t)model->col[at];
            for (r = 0; r < 3; ++r)
                for (c = 0; c < 3; ++c) yi[r] += d[3 * r + c] * xj[c];
            if (yj == yi) continue;
            for (r = 0; r < 3; ++r)
                for (c = 0; c < 3; ++c) yj[c] += d[3 * r + c] * xi[r];
        }
    }
}

SFEM_DEF void sfem_model_multiply_damping(const sfem_model *model, const sfem_real *x, sfem_real *y,
                                          const sfem_exec *exec)
{
    const size_t n = 3 * (size_t)model->mesh.nodes;
    size_t i;
    sfem_matrix_multiply(&model->stiffness, x, y, exec);
    for (i = 0; i < n; ++i) y[i] *= model->beta;
    sfemi_fem_add_mass(model, model->alpha, x, y);
    sfemi_fem_add_damping_rest(model, x, y);
}

/* ---- forces and tangents ---- */

typedef struct sfemi_forces {
    const sfem_model *model;
    const sfem_real *u;
    sfem_real *force, *rotation, *copies, *energy, *inverted; /* the last two by chunk */
    sfemi_blocks_kernel kernel;
} sfemi_forces;

static void sfemi_forces_chunks(void *data, sfem_int index)
{
    const sfemi_forces *job = (const sfemi_forces *)data;
    const sfemi_chunks *c = &job->model->chunks;
    sfem_int k, i, end = (index + 1) * SFEMI_CHUNK_TASK;
    sfem_real u[16 * SFEMI_CHUNK_TETS];
    if (end > c->count) end = c->count;
    for (k = index * SFEMI_CHUNK_TASK; k < end; ++k) {
        const sfem_int first = c->copy_start[k], count = c->copy_start[k + 1] - first;
        sfem_real *out = job->copies + 4 * (size_t)first;
        sfemi_totals totals;
        for (i = 0; i < count; ++i) {
            const sfem_real *from = job->u + 3 * (size_t)c->copy_node[first + i];
            u[4 * i] = from[0], u[4 * i + 1] = from[1], u[4 * i + 2] = from[2], u[4 * i + 3] = 0;
        }
        memset(out, 0, 4 * (size_t)count * sizeof *out);
        job->kernel(c->block + c->block_start[k], c->block_start[k + 1] - c->block_start[k], u, out,
                    job->rotation, &totals);
        job->energy[k] = job->inverted[k] = 0;
        for (i = 0; i < SFEMI_LANES; ++i) {
            job->energy[k] += totals.energy[i];
            job->inverted[k] += totals.inverted[i];
        }
    }
}

static void sfemi_forces_nodes(void *data, sfem_int index)
{
    const sfemi_forces *job = (const sfemi_forces *)data;
    const sfemi_chunks *c = &job->model->chunks;
    sfem_int i, j, end = job->model->mesh.nodes;
    if (end - index * SFEMI_NODE_TASK > SFEMI_NODE_TASK) end = (index + 1) * SFEMI_NODE_TASK;
    for (i = index * SFEMI_NODE_TASK; i < end; ++i) {
        sfem_real x = 0, y = 0, z = 0;
        for (j = c->node_start[i]; j < c->node_start[i + 1]; ++j) {
            const sfem_real *f = job->copies + 4 * (size_t)c->node_copy[j];
            x += f[0], y += f[1], z += f[2];
        }
        job->force[3 * (size_t)i] = x;
        job->force[3 * (size_t)i + 1] = y;
        job->force[3 * (size_t)i + 2] = z;
    }
}

SFEM_DEF size_t sfem_model_work_size(const sfem_model *model)
{
    return 4 * (size_t)model->chunks.copies + 2 * (size_t)model->chunks.count;
}

SFEM_DEF sfem_real sfem_model_forces(const sfem_model *model, const sfem_real *u,
                                     sfem_precision precision, sfem_real *force,
                                     sfem_real *rotation, sfem_int *inverted, sfem_real *work,
                                     const sfem_exec *exec)
{
    const sfem_int chunks = model->chunks.count, nodes = model->mesh.nodes;
    sfem_real energy = 0, turned = 0;
    sfemi_forces job;
    sfem_int k;
    SFEM_ASSERT(u && force && work);
    job.model = model;
    job.u = u;
    job.force = force;
    job.rotation = rotation;
    job.copies = work;
    job.energy = work + 4 * (size_t)model->chunks.copies;
    job.inverted = job.energy + chunks;
    job.kernel = sfemi_blocks_pick(precision);
    sfemi_run(exec, (chunks + SFEMI_CHUNK_TASK - 1) / SFEMI_CHUNK_TASK, sfemi_forces_chunks, &job);
    sfemi_run(exec, (nodes - 1) / SFEMI_NODE_TASK + 1, sfemi_forces_nodes, &job);
    for (k = 0; k < chunks; ++k) {
        energy += job.energy[k];
        turned += job.inverted[k];
    }
    if (inverted) *inverted = (sfem_int)turned;
    return energy;
}

typedef struct sfemi_tangents {
    const sfem_model *model;
    const sfem_real *u;
    sfem_tangent kind;
    sfem_real *val;
    const sfem_int *chunk; /* of one colour */
    sfemi_pairs_kernel kernel;
} sfemi_tangents;

/* Adds the tangent of a lane's tet. */
static void sfemi_tangents_tet(const sfemi_tangents *job, const sfemi_block *block, sfem_int lane)
{
    const sfem_int e = block->tet[lane], *t = job->model->mesh.tet + 4 * (size_t)e;
    const sfem_int *place = job->model->chunks.place + 10 * (size_t)e;
    sfem_real g[4][3], grad[9];
    unsigned swap = 0;
    sfemi_modes modes;
    sfemi_pairs pairs;
    int a, b, i, n;
    for (i = 0; i < 3; ++i) {
        for (a = 1; a < 4; ++a) g[a][i] = block->shape[3 * a - 3 + i][lane];
        g[0][i] = -(g[1][i] + g[2][i] + g[3][i]);
    }
    sfemi_element_deform(job->u + 3 * (size_t)t[0], job->u + 3 * (size_t)t[1],
                         job->u + 3 * (size_t)t[2], job->u + 3 * (size_t)t[3], g, grad);
    sfemi_law_modes((sfem_law)block->law, block->lambda[lane], block->mu[lane], grad, job->kind,
                    &modes);
    for (a = 0, n = 0; a < 4; ++a)
        for (b = 0; b <= a; ++b, ++n) swap |= (unsigned)(t[a] < t[b]) << n;
    sfemi_pairs_fill(&modes, g, swap, &pairs);
    job->kernel(&modes, 1, &pairs);
    for (n = 0; n < 10; ++n) {
        sfem_real *to = job->val + 9 * (size_t)place[n];
        for (i = 0; i < 9; ++i) to[i] += pairs.k[i][n];
    }
}

static void sfemi_tangents_chunk(void *data, sfem_int index)
{
    const sfemi_tangents *job = (const sfemi_tangents *)data;
    const sfemi_chunks *c = &job->model->chunks;
    const sfem_int k = job->chunk[index];
    sfem_int b, lane;
    for (b = c->block_start[k]; b < c->block_start[k + 1]; ++b)
        for (lane = 0; lane < c->block[b].count; ++lane)
            sfemi_tangents_tet(job, c->block + b, lane);
}

SFEM_DEF void sfem_model_tangent(const sfem_model *model, const sfem_real *u, sfem_tangent kind,
                                 sfem_matrix *tangent, const sfem_exec *exec)
{
    const sfemi_chunks *c = &model->chunks;
    sfemi_tangents job;
    sfem_int n;
    SFEM_ASSERT(u && tangent && tangent->n == model->mesh.nodes);
    SFEM_ASSERT(tangent->row[tangent->n] == model->row[tangent->n]);
    job.model = model;
    job.u = u;
    job.kind = kind;
    job.val = tangent->val;
    job.kernel = sfemi_pairs_pick();
    memset(job.val, 0, 9 * (size_t)model->row[model->mesh.nodes] * sizeof *job.val);
    for (n = 0; n < c->colors; ++n) {
        job.chunk = c->color_chunk + c->color_start[n];
        sfemi_run(exec, c->color_start[n + 1] - c->color_start[n], sfemi_tangents_chunk, &job);
    }
}

SFEM_DEF void sfem_model_stress(const sfem_model *model, const sfem_real *u, sfem_real *stress,
                                sfem_real *von_mises)
{
    sfem_int e;
    for (e = 0; e < model->mesh.tets; ++e) {
        sfem_real g[4][3], strain[6], s[6];
        sfemi_element_gradients(&model->mesh, e, g);
        sfemi_element_strain(model->mesh.tet + 4 * (size_t)e, g, u, strain);
        sfemi_element_hooke(model->lambda[e], model->mu[e], strain, s);
        if (stress) memcpy(stress + 6 * (size_t)e, s, sizeof s);
        if (von_mises)
            von_mises[e] =
                sqrt(((s[0] - s[1]) * (s[0] - s[1]) + (s[1] - s[2]) * (s[1] - s[2]) +
                      (s[2] - s[0]) * (s[2] - s[0])) / 2 +
                     3 * (s[3] * s[3] + s[4] * s[4] + s[5] * s[5]));
    }
}

SFEM_DEF sfem_real sfem_model_elastic_energy(const sfem_model *model, const sfem_real *u)
{
    sfem_real energy = 0;
    sfem_int e;
    int i;
    for (e = 0; e < model->mesh.tets; ++e) {
        sfem_real g[4][3], strain[6], s[6], density = 0;
        sfemi_element_gradients(&model->mesh, e, g);
        sfemi_element_strain(model->mesh.tet + 4 * (size_t)e, g, u, strain);
        sfemi_element_hooke(model->lambda[e], model->mu[e], strain, s);
        for (i = 0; i < 6; ++i) density += strain[i] * s[i];
        energy += model->volume[e] * density / 2;
    }
    return energy;
}

SFEM_DEF void sfem_add_gravity(const sfem_model *model, const sfem_real g[3], sfem_real *force)
{
    size_t i;
    for (i = 0; i < 3 * (size_t)model->mesh.nodes; ++i) force[i] += model->node_mass[i / 3] * g[i % 3];
}

/* Twice the area vector of a triangle, outward for an outward triangle. */
static void sfemi_fem_area2(const sfem_mesh *mesh, const sfem_real *x, const sfem_int *tri,
                            sfem_real area2[3])
{
    const sfem_real *at = x ? x : mesh->x;
    sfem_real u[3], v[3];
    sfemi_sub3(at + 3 * (size_t)tri[1], at + 3 * (size_t)tri[0], u);
    sfemi_sub3(at + 3 * (size_t)tri[2], at + 3 * (size_t)tri[0], v);
    sfemi_cross(u, v, area2);
}

SFEM_DEF void sfem_add_traction(const sfem_mesh *mesh, const sfem_real *x, sfem_int count,
                                const sfem_int *tri, const sfem_real t[3], sfem_real *force)
{
    sfem_int k;
    int a, c;
    for (k = 0; k < count; ++k) {
        sfem_real area2[3], third;
        sfemi_fem_area2(mesh, x, tri + 3 * (size_t)k, area2);
        third = sqrt(sfemi_dot3(area2, area2)) / 6;
        for (a = 0; a < 3; ++a)
            for (c = 0; c < 3; ++c)
                force[3 * (size_t)tri[3 * (size_t)k + (size_t)a] + (size_t)c] += third * t[c];
    }
}

SFEM_DEF void sfem_add_pressure(const sfem_mesh *mesh, const sfem_real *x, sfem_int count,
                                const sfem_int *tri, sfem_real p, sfem_real *force)
{
    sfem_int k;
    int a, c;
    for (k = 0; k < count; ++k) {
        sfem_real area2[3];
        sfemi_fem_area2(mesh, x, tri + 3 * (size_t)k, area2);
        for (a = 0; a < 3; ++a)
            for (c = 0; c < 3; ++c)
                force[3 * (size_t)tri[3 * (size_t)k + (size_t)a] + (size_t)c] -= p * area2[c] / 6;
    }
}

/* ============================================================================================
 * >>damage   edge form of the tet, damage laws, criterion, pieces
 * ============================================================================================ */

/* ============================================================================================
 * >>factor   the shared factor of a body's system matrix
 *
 * A = ck K + cm M + cd (rest of D) on the nodes that are not pinned on all axes; axes pinned one by one
 * keep their row as ck K_ii + .. on the diagonal and zero elsewhere. In place of K there may be its
 * isotropic majorant (2 mu + 3 lambda) L (x) I, L the Laplacian sum V g_a.g_b: with e = dx/dX of a vector
 * x, 2 mu |R^T e|^2 + lambda tr(R^T e)^2 <= (2 mu + 3 lambda) |e|^2, whatever the tets' rotations R. All bodies of a model with the
 * same coefficients and pins use one factor: it is looked up in the model's list, under its lock, and
 * goes when its last body lets go. A factor never changes after it is made.
 * ============================================================================================ */

typedef struct sfemi_factor_key {
    sfem_real ck, cm, cd;
    int majorant; /* ck times the isotropic majorant in place of K */
    const unsigned char *mask; /* [nodes] axes held */
    sfem_precision precision;
    sfem_ordering ordering;
} sfemi_factor_key;

struct sfem_factor {
    sfem_factor *next;
    sfem_int references;
    sfemi_factor_key key; /* its mask is the factor's own */
    unsigned char *mask;
    sfem_int free_nodes;
    sfem_int *node;     /* [free_nodes] their numbers in the mesh */
    sfem_real *inverse; /* [free_nodes][3] if A is diagonal, else NULL */
    sfem_ldl *ldl;      /* else this */
};

static int sfemi_factor_matches(const sfem_factor *f, const sfemi_factor_key *key, size_t nodes)
{
    return f->key.ck == key->ck && f->key.cm == key->cm && f->key.cd == key->cd &&
           f->key.majorant == key->majorant && f->key.precision == key->precision && f->key.ordering == key->ordering &&
           memcmp(f->mask, key->mask, nodes) == 0;
}

static void sfemi_factor_destroy(sfem_model *model, sfem_factor *f)
{
    const sfem_allocator *al = &model->allocator;
    if (!f) return;
    sfem_ldl_free(f->ldl);
    sfemi_delete(al, f->inverse);
    sfemi_delete(al, f->node);
    sfemi_delete(al, f->mask);
    sfemi_delete(al, f);
}

static void sfemi_factor_release(sfem_model *model, sfem_factor *f)
{
    sfem_factor **link;
    sfem_int left;
    if (!f) return;
    sfemi_lock(&model->lock);
    left = --f->references;
    for (link = &model->factors; left == 0 && *link; link = &(*link)->next) {
        if (*link != f) continue;
        *link = f->next;
        break;
    }
    sfemi_unlock(&model->lock);
    if (left == 0) sfemi_factor_destroy(model, f);
}

/* A factor in the model's list that has this key, or with `like` set, one whose analysis serves it (same
 * pins, other coefficients); retained, or NULL. */
static sfem_factor *sfemi_factor_find(sfem_model *model, const sfemi_factor_key *key, int like)
{
    const size_t nodes = (size_t)model->mesh.nodes;
    sfem_factor *f;
    sfemi_lock(&model->lock);
    for (f = model->factors; f; f = f->next) {
        sfemi_factor_key k = *key;
        if (like) {
            if (!f->ldl) continue;
            k.ck = f->key.ck;
            k.cm = f->key.cm;
            k.cd = f->key.cd;
            k.majorant = f->key.majorant;
        }
        if (!sfemi_factor_matches(f, &k, nodes)) continue;
        ++f->references;
        break;
    }
    sfemi_unlock(&model->lock);
    return f;
}

static sfem_real sfemi_factor_isotropic(const sfem_model *model, sfem_int e)
{
    return model->volume[e] * (2 * model->mu[e] + 3 * fmax(model->lambda[e], 0.0));
}

/* y = the majorant times x. */
static void sfemi_factor_multiply_majorant(const sfem_model *model, const sfem_real *x, sfem_real *y)
{
    sfem_int e;
    int a, i, j;
    memset(y, 0, 3 * (size_t)model->mesh.nodes * sizeof *y);
    for (e = 0; e < model->mesh.tets; ++e) {
        const sfem_int *t = model->mesh.tet + 4 * (size_t)e;
        sfem_real g[4][3], d[3][3];
        sfemi_element_gradients(&model->mesh, e, g);
        for (i = 0; i < 3; ++i)
            for (j = 0; j < 3; ++j) {
                d[i][j] = 0;
                for (a = 1; a < 4; ++a)
                    d[i][j] += g[a][j] * (x[3 * (size_t)t[a] + (size_t)i] - x[3 * (size_t)t[0] + (size_t)i]);
                d[i][j] *= sfemi_factor_isotropic(model, e);
            }
        for (a = 0; a < 4; ++a)
            for (i = 0; i < 3; ++i) y[3 * (size_t)t[a] + (size_t)i] += sfemi_dot3(d[i], g[a]);
    }
}

/* The majorant's scalars [blocks], to be freed, where the key wants it; else NULL. */
static sfem_status sfemi_factor_majorant(const sfem_model *model, const sfemi_factor_key *key,
                                         sfem_real **out, sfem_error *err)
{
    sfem_real *scalar = NULL;
    sfem_status status = SFEM_OK;
    sfem_int e;
    int a, b;
    *out = NULL;
    if (!key->majorant) return SFEM_OK;
    SFEMI_NEW(sfem_real, scalar, &model->allocator, model->row[model->mesh.nodes]);
    for (e = 0; e < model->mesh.tets; ++e) {
        const sfem_int *t = model->mesh.tet + 4 * (size_t)e;
        sfem_real g[4][3];
        sfemi_element_gradients(&model->mesh, e, g);
        for (a = 0; a < 4; ++a)
            for (b = 0; b < 4; ++b)
                if (t[a] >= t[b])
                    scalar[sfemi_fem_find(model->row, model->col, t[a], t[b])] +=
                        sfemi_factor_isotropic(model, e) * sfemi_dot3(g[a], g[b]);
    }
    *out = scalar;
done:
    return status;
}

/* Block (i, j) of A at place `at` of the pattern, without what couples held axes. */
static void sfemi_factor_block(const sfem_model *model, const sfem_factor *f, const sfem_real *majorant,
                               sfem_int at, sfem_int i, sfem_real b[9])
{
    const sfem_int j = model->col[at];
    int r, c;
    sfemi_fem_block(model, at, i, majorant ? 0 : f->key.ck, f->key.cm, f->key.cd, b);
    for (r = 0; majorant && r < 9; r += 4) b[r] += f->key.ck * majorant[at];
    for (r = 0; r < 3; ++r)
        for (c = 0; c < 3; ++c)
            if (((f->mask[i] >> r & 1) || (f->mask[j] >> c & 1)) && !(i == j && r == c)) b[3 * r + c] = 0;
}

/* The rows and columns of A that are free. */
static sfem_status sfemi_factor_matrix(const sfem_model *model, const sfem_factor *f, sfem_matrix *out,
                                       sfem_error *err)
{
    const sfem_allocator *al = &model->allocator;
    sfem_int *number = NULL, *row = NULL, *col = NULL, k, at, blocks = 0;
    sfem_real *majorant = NULL;
    sfem_matrix a;
    sfem_status status = SFEM_OK;
    memset(&a, 0, sizeof a);
    SFEMI_TRY(sfemi_factor_majorant(model, &f->key, &majorant, err));
    SFEMI_NEW(sfem_int, number, al, model->mesh.nodes); /* 1 + its row, 0: not free */
    for (k = 0; k < f->free_nodes; ++k) number[f->node[k]] = k + 1;
    for (k = 0; k < f->free_nodes; ++k)
        for (at = model->row[f->node[k]]; at < model->row[f->node[k] + 1]; ++at)
            blocks += number[model->col[at]] > 0;
    SFEMI_TRY(sfemi_fem_new_matrix(f->free_nodes, (size_t)blocks, al, &row, &col, &a, err));
    blocks = 0;
    for (k = 0; k < f->free_nodes; ++k) {
        for (at = model->row[f->node[k]]; at < model->row[f->node[k] + 1]; ++at) {
            if (number[model->col[at]] == 0) continue;
            col[blocks] = number[model->col[at]] - 1;
            sfemi_factor_block(model, f, majorant, at, f->node[k], a.val + 9 * (size_t)blocks++);
        }
        row[k + 1] = blocks;
    }
    *out = a;
done:
    if (status != SFEM_OK) sfem_matrix_free(&a, al);
    sfemi_delete(al, majorant);
    sfemi_delete(al, number);
    return status;
}

/* The factorisation from scratch, ordered with the help of the nodes' places. */
static sfem_status sfemi_factor_analyse(sfem_model *model, sfem_factor *f, const sfem_matrix *a,
                                        const sfem_exec *exec, sfem_error *err)
{
    const sfem_allocator *al = &model->allocator;
    sfem_ldl_def def = sfem_default_ldl_def();
    sfem_real *x = NULL;
    sfem_status status = SFEM_OK;
    sfem_int k;
    SFEMI_NEW(sfem_real, x, al, 3 * (size_t)f->free_nodes);
    for (k = 0; k < f->free_nodes; ++k)
        memcpy(x + 3 * (size_t)k, model->mesh.x + 3 * (size_t)f->node[k], 3 * sizeof *x);
    def.ordering = f->key.ordering;
    def.mixed = f->key.precision == SFEM_MIXED;
    def.allocator = model->allocator;
    def.exec = *exec;
    def.x = x;
    SFEMI_TRY(sfem_ldl_create(&def, a, &f->ldl, err));
done:
    sfemi_delete(al, x);
    return status;
}

static sfem_status sfemi_factor_compute(sfem_model *model, sfem_factor *f, const sfem_exec *exec,
                                        sfem_error *err)
{
    sfem_factor *like;
    sfem_matrix a;
    sfem_error place;
    sfem_status status = sfemi_factor_matrix(model, f, &a, err);
    if (status != SFEM_OK) return status;
    like = sfemi_factor_find(model, &f->key, 1);
    status = like ? sfem_ldl_create_like(like->ldl, &a, &f->ldl, &place)
                  : sfemi_factor_analyse(model, f, &a, exec, &place);
    sfemi_factor_release(model, like);
    sfem_matrix_free(&a, &model->allocator);
    if (status == SFEM_NOT_SPD && place.node >= 0)
        return sfemi_fail_at(err, status, f->node[place.node], -1, "node %d is held by nothing",
                             (int)f->node[place.node]);
    if (status != SFEM_OK && err) *err = place;
    return status;
}

/* Makes a factor of its own, in nobody's list yet. */
static sfem_status sfemi_factor_make(sfem_model *model, const sfemi_factor_key *key,
                                     const sfem_exec *exec, sfem_factor **out, sfem_error *err)
{
    const sfem_allocator *al = &model->allocator;
    const size_t nodes = (size_t)model->mesh.nodes;
    sfem_factor *f = NULL;
    sfem_status status = SFEM_OK;
    sfem_int i, k = 0;
    int c;
    SFEMI_NEW(sfem_factor, f, al, 1);
    SFEMI_NEW(unsigned char, f->mask, al, nodes);
    memcpy(f->mask, key->mask, nodes);
    f->key = *key;
    f->key.mask = f->mask;
    f->references = 1;
    for (i = 0; i < model->mesh.nodes; ++i) f->free_nodes += f->mask[i] != SFEM_AXIS_ALL;
    SFEMI_NEW(sfem_int, f->node, al, f->free_nodes);
    for (i = 0; i < model->mesh.nodes; ++i)
        if (f->mask[i] != SFEM_AXIS_ALL) f->node[k++] = i;
    if (key->ck == 0 && (key->cd == 0 || !model->damping) && !model->block_mass) {
        SFEMI_NEW(sfem_real, f->inverse, al, 3 * (size_t)f->free_nodes);
        for (k = 0; k < f->free_nodes; ++k)
            for (c = 0; c < 3; ++c)
                f->inverse[3 * k + c] = 1 / (key->cm * model->node_mass[f->node[k]]);
    } else if (f->free_nodes > 0) {
        SFEMI_TRY(sfemi_factor_compute(model, f, exec, err));
    }
    *out = f;
    return SFEM_OK;
done:
    sfemi_factor_destroy(model, f);
    return status;
}

/* The factor with this key, from the list or new; *made counts new ones. */
static sfem_status sfemi_factor_get(sfem_model *model, const sfemi_factor_key *key,
                                    const sfem_exec *exec, sfem_factor **out, sfem_int *made,
                                    sfem_error *err)
{
    sfem_status status;
    *out = sfemi_factor_find(model, key, 0);
    if (*out) return SFEM_OK;
    status = sfemi_factor_make(model, key, exec, out, err);
    if (status != SFEM_OK) return status;
    ++*made;
    sfemi_lock(&model->lock);
    (*out)->next = model->factors;
    model->factors = *out;
    sfemi_unlock(&model->lock);
    return SFEM_OK;
}

static size_t sfemi_factor_work_size(const sfem_factor *f, sfem_int rhs)
{
    return 3 * (size_t)f->free_nodes * (size_t)rhs + (f->ldl ? sfem_ldl_work_size(f->ldl, rhs) : 0);
}

/* x = A^-1 b on the free axes of `rhs` vectors [nodes][3]; the held axes of x are left alone. b and x
 * may be the same. work: sfemi_factor_work_size. */
static void sfemi_factor_solve(const sfem_factor *f, sfem_int nodes, sfem_int rhs, const sfem_real *b,
                               sfem_real *x, sfem_real *work, const sfem_exec *exec)
{
    const size_t n = 3 * (size_t)nodes, m = 3 * (size_t)f->free_nodes;
    sfem_int s, k;
    int c;
    for (s = 0; s < rhs; ++s)
        for (k = 0; k < f->free_nodes; ++k)
            for (c = 0; c < 3; ++c)
                work[(size_t)s * m + 3 * (size_t)k + (size_t)c] =
                    f->mask[f->node[k]] >> c & 1 ? 0 : b[(size_t)s * n + 3 * (size_t)f->node[k] + (size_t)c];
    if (f->ldl) sfem_ldl_solve(f->ldl, rhs, work, work + (size_t)rhs * m, exec);
    for (s = 0; s < rhs; ++s)
        for (k = 0; k < f->free_nodes; ++k)
            for (c = 0; c < 3; ++c) {
                const size_t at = (size_t)s * m + 3 * (size_t)k + (size_t)c;
                if (f->mask[f->node[k]] >> c & 1) continue;
                x[(size_t)s * n + 3 * (size_t)f->node[k] + (size_t)c] =
                    f->inverse ? f->inverse[3 * k + c] * work[at] : work[at];
            }
}

/* ============================================================================================
 * >>state   what of a body changes, in one block of memory
 * ============================================================================================ */

/* Something that holds points in place: the history that gives its velocity and acceleration. */
typedef struct sfemi_hold {
    sfem_real target[3]; /* position at the end of the next step */
    sfem_real past[3];   /* position at the start of the last one */
    sfem_int age;        /* steps since it was taken, up to 2 */
} sfemi_hold;

typedef struct sfemi_handle {
    sfemi_hold hold;
    sfem_int used, node[4];
    sfem_real weight[4];
    sfem_real force[3]; /* N, on the body, over the last step */
} sfemi_handle;

typedef struct sfemi_state_head {
    char magic[8];
    uint32_t version, checksum;
    uint64_t size, key; /* key: what it belongs to */
    sfem_real time, h;  /* h: of the last step */
    sfem_real gravity[3];
    sfem_int started;   /* 0: w holds v, the first step comes next; 1: sfem_body_start was called */
    sfem_int load_age;  /* steps since the load last changed, up to 2 */
    sfem_int loaded;    /* the load was ever set */
    sfem_int current;   /* f, psi and frame belong to u */
    sfem_int rebase;    /* SFEMI_REBASE where what counts as free has changed: a new ledger */
    sfem_int unused;
    int64_t steps, redone, descents;
    sfem_real psi, budget, scale, last; /* >>guard: the energy at u, the ledger, Ec of the last step, */
    sfem_real energy;                   /* and what it conserves */
} sfemi_state_head;

/* RESTARTED: as not started, but the loads have their history. */
enum { SFEMI_LEDGER, SFEMI_REBASE, SFEMI_NEW_LEDGER };
enum { SFEMI_NOT_STARTED, SFEMI_LOAD_FIXED, SFEMI_RESTARTED, SFEMI_RUNNING };

/* The block: head, then these, in this order. w is the velocity for Newmark and before the first step,
 * the mean velocity over the last step for (p,q,r). */
typedef struct sfemi_state {
    sfemi_state_head *head;
    sfem_real *u, *w, *a;  /* [nodes][3] */
    sfem_real *force[3];   /* [nodes][3] at the end of the next step, at its start, one step before */
    sfem_real *f, *f_past; /* [nodes][3] the internal force at u and one step before; these and */
    sfem_real *frame;      /* [nodes][3][3] Q: only where the body turns */
    sfemi_hold *pin;       /* [pin_count] */
    sfemi_handle *handle;  /* [max_handles] */
} sfemi_state;

/* reals a node: u, w, a and three loads; f, f_past and frame besides */
static size_t sfemi_state_reals(sfem_int nodes, int turns) { return (turns ? 33 : 18) * (size_t)nodes; }

static size_t sfemi_state_bytes(sfem_int nodes, int turns, sfem_int pins, sfem_int handles)
{
    return sizeof(sfemi_state_head) + sfemi_state_reals(nodes, turns) * sizeof(sfem_real) +
           (size_t)pins * sizeof(sfemi_hold) + (size_t)handles * sizeof(sfemi_handle);
}

static void sfemi_state_lay_out(sfemi_state *s, void *block, sfem_int nodes, int turns, sfem_int pins)
{
    const size_t n = 3 * (size_t)nodes;
    sfem_real *at = (sfem_real *)(void *)((char *)block + sizeof(sfemi_state_head));
    int k;
    s->head = (sfemi_state_head *)block;
    s->u = at;
    s->w = at + n;
    s->a = at + 2 * n;
    for (k = 0; k < 3; ++k) s->force[k] = at + (3 + (size_t)k) * n;
    s->f = turns ? at + 6 * n : NULL;
    s->f_past = turns ? at + 7 * n : NULL;
    s->frame = turns ? at + 8 * n : NULL;
    s->pin = (sfemi_hold *)(void *)(at + sfemi_state_reals(nodes, turns));
    s->handle = (sfemi_handle *)(void *)(s->pin + pins);
}

/* FNV-1a [Fowler, Noll, Vo 1991]. */
static uint64_t sfemi_state_hash(uint64_t hash, const void *data, size_t bytes)
{
    const unsigned char *p = (const unsigned char *)data;
    size_t i;
    for (i = 0; i < bytes; ++i) hash = (hash ^ p[i]) * 0x100000001b3u;
    return hash;
}

static uint32_t sfemi_state_checksum(const void *block, size_t bytes)
{
    sfemi_state_head head;
    uint64_t hash;
    memcpy(&head, block, sizeof head);
    head.checksum = 0;
    hash = sfemi_state_hash(0xcbf29ce484222325u, &head, sizeof head);
    hash = sfemi_state_hash(hash, (const char *)block + sizeof head, bytes - sizeof head);
    return (uint32_t)(hash ^ hash >> 32);
}

/* ============================================================================================
 * >>handle   pins and handles set, moved and released while the body runs
 *
 * With A^-1 at hand, a constraint H a = c on a = A^-1 (b + H^T l) asks for  (H A^-1 H^T) l = c - H A^-1 b.
 * The columns Y = A^-1 H^T of a handle, three of them, are solved for when it is taken; a step costs one
 * small dense solve and one sum over the columns, whatever moves.
 * ============================================================================================ */

typedef struct sfemi_grip {
    sfem_int count;   /* handles in use */
    sfem_int *slot;   /* [max] their numbers */
    sfem_real **y;    /* [max] columns by number, [3][nodes][3] each, or NULL; where the body turns, so many
                       * for each of the handle's nodes */
    sfem_int *parts;  /* [max] for how many nodes there is room in y */
    sfem_int *ready;  /* [max] the columns belong to the body's factor and this handle */
    sfem_real *s;     /* [3 max][3 max] L D L^T of H A^-1 H^T, lower; 0 pivots are rows left out */
    sfem_real *wm;    /* [3][max][max] the same of H M^-1 H^T, an axis at a time */
    sfem_real *lambda; /* [3 max] */
    sfem_real *place;  /* [3 max] where the handles are before a step */
    int dirty;        /* the set of handles or the factor changed */
} sfemi_grip;

/* In-place L D L^T of a small symmetric matrix, lower, row-major with the given stride. A row whose
 * pivot is lost depends on those before it: its pivot becomes 0, which leaves it out. */
static void sfemi_grip_factor(sfem_real *a, sfem_int n, sfem_int stride)
{
    sfem_int i, j, k;
    for (i = 0; i < n; ++i) {
        const sfem_real whole = a[i * stride + i];
        for (j = 0; j < i; ++j) {
            sfem_real sum = a[i * stride + j];
            for (k = 0; k < j; ++k) sum -= a[i * stride + k] * a[k * stride + k] * a[j * stride + k];
            a[i * stride + j] = a[j * stride + j] > 0 ? sum / a[j * stride + j] : 0;
        }
        for (k = 0; k < i; ++k) a[i * stride + i] -= a[i * stride + k] * a[i * stride + k] * a[k * stride + k];
        if (!(a[i * stride + i] > 1e-9 * whole)) a[i * stride + i] = 0;
    }
}

static void sfemi_grip_solve(const sfem_real *a, sfem_int n, sfem_int stride, sfem_real *x,
                             sfem_int step)
{
    sfem_int i, k;
    for (i = 0; i < n; ++i)
        for (k = 0; k < i; ++k) x[i * step] -= a[i * stride + k] * x[k * step];
    for (i = 0; i < n; ++i) x[i * step] = a[i * stride + i] > 0 ? x[i * step] / a[i * stride + i] : 0;
    for (i = n - 1; i >= 0; --i)
        for (k = i + 1; k < n; ++k) x[i * step] -= a[k * stride + i] * x[k * step];
    for (i = 0; i < n; ++i)
        if (!(a[i * stride + i] > 0)) x[i * step] = 0;
}

/* (H x) of one handle: the weighted mean over its nodes. */
static void sfemi_grip_mean(const sfemi_handle *h, const sfem_real *x, sfem_real out[3])
{
    int k, c;
    for (c = 0; c < 3; ++c) {
        out[c] = 0;
        for (k = 0; k < 4; ++k)
            if (h->weight[k] != 0) out[c] += h->weight[k] * x[3 * (size_t)h->node[k] + (size_t)c];
    }
}

/* Y = A^-1 H^T of one handle, or `apart` for each of its nodes alone, with weight one. */
static void sfemi_grip_columns(const sfem_factor *f, const sfemi_handle *h, sfem_int nodes, int apart,
                               sfem_real *y, sfem_real *work, const sfem_exec *exec)
{
    const size_t n = 3 * (size_t)nodes;
    int first, k, c;
    for (first = 0; first < (apart ? 4 : 1); ++first) {
        if (h->weight[first] == 0 && apart) continue;
        memset(y, 0, 3 * n * sizeof *y);
        for (c = 0; c < 3; ++c)
            for (k = first; k < (apart ? first + 1 : 4); ++k)
                if (h->weight[k] != 0 && !(f->mask[h->node[k]] >> c & 1))
                    y[(size_t)c * n + 3 * (size_t)h->node[k] + (size_t)c] += apart ? 1 : h->weight[k];
        sfemi_factor_solve(f, nodes, 3, y, y, work, exec);
        y += 3 * n;
    }
}

/* Factors S = H Y, unless the body turns, and W = H M^-1 H^T over the handles in g->slot. */
static void sfemi_grip_gather(sfemi_grip *g, const sfemi_handle *handle, const sfem_model *model,
                              int turns, const unsigned char *mask)
{
    const size_t n = 3 * (size_t)model->mesh.nodes;
    const sfem_int k = g->count;
    sfem_int i, j;
    int a, b, p, q;
    for (i = 0; i < k; ++i) {
        const sfemi_handle *hi = handle + g->slot[i];
        for (j = 0; j <= i; ++j) {
            const sfemi_handle *hj = handle + g->slot[j];
            for (b = 0; b < 3; ++b) {
                sfem_real mean[3], w = 0;
                if (!turns) sfemi_grip_mean(hi, g->y[g->slot[j]] + (size_t)b * n, mean);
                for (a = 0; a < 3 && !turns; ++a) g->s[(3 * i + a) * 3 * k + 3 * j + b] = mean[a];
                for (p = 0; p < 4; ++p)
                    for (q = 0; q < 4; ++q)
                        if (hi->node[p] == hj->node[q] && hi->weight[p] != 0 && hj->weight[q] != 0 &&
                            !(mask[hi->node[p]] >> b & 1))
                            w += hi->weight[p] * hj->weight[q] / model->node_mass[hi->node[p]];
                g->wm[(b * k + i) * k + j] = w;
            }
        }
    }
    if (!turns) sfemi_grip_factor(g->s, 3 * k, 3 * k);
    for (b = 0; b < 3; ++b) sfemi_grip_factor(g->wm + b * k * k, k, k);
}

/* l = S^-1 (c - H a), a += Y l, where lambda comes in as c. */
static void sfemi_grip_apply(sfemi_grip *g, const sfemi_handle *handle, sfem_int nodes, sfem_real *a)
{
    const size_t n = 3 * (size_t)nodes;
    sfem_int i;
    size_t k;
    int c;
    for (i = 0; i < g->count; ++i) {
        sfem_real mean[3];
        sfemi_grip_mean(handle + g->slot[i], a, mean);
        for (c = 0; c < 3; ++c) g->lambda[3 * i + c] -= mean[c];
    }
    sfemi_grip_solve(g->s, 3 * g->count, 3 * g->count, g->lambda, 1);
    for (i = 0; i < g->count; ++i) {
        for (c = 0; c < 3; ++c) {
            const sfem_real *y = g->y[g->slot[i]] + (size_t)c * n, l = g->lambda[3 * i + c];
            for (k = 0; k < n; ++k) a[k] += l * y[k];
        }
    }
}

/* x += M^-1 H^T m with H x = c, where lambda comes in as c: the least change of x, in the mass norm. A
 * lumped M serves: it only chooses among the changes. */
static void sfemi_grip_project(sfemi_grip *g, const sfemi_handle *handle, const sfem_model *model,
                               const unsigned char *mask, sfem_real *x)
{
    const sfem_int k = g->count;
    sfem_int i;
    int c, p;
    for (i = 0; i < k; ++i) {
        sfem_real mean[3];
        sfemi_grip_mean(handle + g->slot[i], x, mean);
        for (c = 0; c < 3; ++c) g->lambda[3 * i + c] -= mean[c];
    }
    for (c = 0; c < 3; ++c) sfemi_grip_solve(g->wm + c * k * k, k, k, g->lambda + c, 3);
    for (i = 0; i < k; ++i) {
        const sfemi_handle *h = handle + g->slot[i];
        for (p = 0; p < 4; ++p)
            for (c = 0; c < 3; ++c)
                if (h->weight[p] != 0 && !(mask[h->node[p]] >> c & 1))
                    x[3 * (size_t)h->node[p] + (size_t)c] +=
                        h->weight[p] * g->lambda[3 * i + c] / model->node_mass[h->node[p]];
    }
}

/* Velocity and acceleration at the end of a step of h seconds that goes from x to hold->target, after one
 * of h_before seconds: of second and first order once three positions are known. */
static void sfemi_hold_motion(const sfemi_hold *hold, const sfem_real *x, sfem_real h,
                              sfem_real h_before, sfem_real v[3], sfem_real a[3])
{
    int c;
    for (c = 0; c < 3; ++c) {
        const sfem_real d = (hold->target[c] - x[c]) / h;
        a[c] = hold->age > 0 ? 2 * (d - (x[c] - hold->past[c]) / h_before) / (h + h_before) : 0;
        v[c] = d + h / 2 * a[c];
    }
}

static void sfemi_hold_advance(sfemi_hold *hold, const sfem_real *x)
{
    memcpy(hold->past, x, sizeof hold->past);
    if (hold->age < 2) ++hold->age;
}

/* >>turn: one connected piece, at the positions of the last sfemi_turn_locate. */
typedef struct sfemi_piece {
    int held; /* by a pin or a handle: no projection */
    sfem_real rest; /* sum m |X - centre|^2 */
    sfem_real mass, centre[3], inertia_inverse[9];
    sfem_real motion[6], kept[6]; /* scratch: velocity of the centre, angular velocity */
    sfem_real sum[4][3];          /* scratch of the energies */
} sfemi_piece;

typedef struct sfemi_turn {
    sfem_int pieces;
    sfem_int *piece_of;  /* [nodes] -1: in no tet */
    sfemi_piece *piece;  /* [pieces] */
    sfem_real *rotation; /* [tets][3][3] */
    sfem_real *work;     /* of sfem_model_forces */
    sfem_real *v;        /* [nodes][3] scratch */
    sfem_real *sum;      /* [nodes][3][3], [nodes] scratch of the frames */
} sfemi_turn;

/* >>guard: what a step is done again with, for steps of h; factor is NULL until that is needed. */
typedef struct sfemi_redo {
    sfem_factor *factor;
    sfem_real h;
    sfemi_grip grip; /* the handles' columns for it */
} sfemi_redo;

enum { SFEMI_TURNED, SFEMI_ISOTROPIC, SFEMI_REDOS };

/* Pairs of steps and changes of the gradient that the descent by the isotropic majorant remembers. */
enum { SFEMI_MEMORY = 6 };

/* >>guard: scratch of a step, all [nodes][3] unless stated. */
typedef struct sfemi_guard {
    sfem_real *u, *w, *f;  /* the step's end */
    sfem_real *external;   /* the loads as the corrections weigh them */
    sfem_real *y, *grad, *dir, *trial_u, *trial_f, *frame; /* of the redo; frame [nodes][3][3] */
    sfem_real *unit;       /* frames that do not turn */
    sfemi_redo redo[SFEMI_REDOS]; /* A with p = 1, and with the isotropic majorant */
    sfem_real *pair;       /* [SFEMI_MEMORY][2] of its steps, made with its factor */
    int pairs;             /* so many so far in this redo */
    sfem_real psi;         /* at u */
    int redone;            /* u, w, f come from the redo */
    int crumpled;          /* which needed the isotropic majorant */
    sfem_int corrections;  /* made in the last step */
} sfemi_guard;
/* What >>implicit works with. */
typedef struct sfemi_stage {
    sfem_real m1, m0, w1, w0, c1, c2; /* see there */
    sfem_real vv, va, vd, av, aa, ad, am; /* V = vv v + va a + vd d_mid, A = av v + .. + am v_mid */
    sfem_real end; /* where in the step it ends, in h */
} sfemi_stage;

typedef struct sfemi_system {
    sfem_factor *factor;
    sfem_matrix matrix; /* its free rows; without values where the matrix never changes */
    sfem_int *source;   /* [blocks] their places in K's pattern */
} sfemi_system;

typedef struct sfemi_implicit {
    sfem_newton_info info;
    sfemi_stage stage;
    sfemi_system system; /* its factor is the body's */
    sfem_factor *second; /* linear bodies: that of the second of two systems */
    sfem_matrix tangent; /* K(u): the model's K itself where that is constant */
    sfem_matrix drag;    /* of the caller's damping, or no values */
    int tangent_ready;   /* tangent, of the kind asked for, belongs to the last evaluation */
    int still;           /* statics: no inertia, no damping */
    sfem_real share;     /* statics: of the load */
    sfem_real energy;    /* Psi at the last evaluation */
    sfem_real *memory;   /* what follows: [nodes][3] each */
    sfem_real *d, *best, *goal, *vmap, *amap, *a0, *load, *f, *q, *x, *v, *step, *mid_d, *mid_v, *mid_a;
    sfem_real *work;     /* of sfem_model_forces */
} sfemi_implicit;

enum { SFEMI_IMPLICIT_VECTORS = 15 };

/* What a step is made of. The arrays from u to handle are the state; the rest is derived or scratch. */
struct sfem_body {
    sfem_allocator allocator;
    sfem_exec exec;
    sfem_model *model;
    sfem_body_def def;   /* without its pins */
    sfem_int pin_count;
    sfem_int *pin;       /* [pin_count] nodes, each once */
    unsigned char *mask; /* [nodes] axes held; all of a node that is in no tet */
    sfem_real alpha, beta; /* Rayleigh damping, the model's and the body's own */
    int turns;             /* a nonlinear law: >>turn and >>guard apply */
    sfemi_state state;
    sfemi_grip grip;
    sfemi_turn turn;
    sfemi_guard guard;
    /* prepared */
    sfem_factor *factor;
    sfem_real h, p;      /* what the factor is for */
    sfem_factor *static_factor; /* of K alone, once a static solution was asked for */
    sfem_real omega_max; /* 0: not known */
    sfem_int factors_made;
    sfem_real *work;     /* for the factor's solves */
    size_t work_size;
    /* the step under way */
    int phase;           /* SFEMI_IDLE, SFEMI_PREDICTED, SFEMI_SOLVED */
    sfem_real step;      /* its h */
    sfem_real *rhs, *acc, *zk, *zm, *zd; /* [nodes][3]; zd only where the model has damping of its own */
    sfemi_implicit implicit;
};

enum { SFEMI_IDLE, SFEMI_PREDICTED, SFEMI_SOLVED };

/* Coefficients of A = r M + (q/2) h D + p h^2 K for the body's integrator, D resolved into K, M, rest. */
typedef struct sfemi_coefficients {
    sfem_real p, q, r;
} sfemi_coefficients;

static sfemi_coefficients sfemi_body_coefficients(const sfem_body *b, sfem_real p)
{
    sfemi_coefficients k;
    k.p = p;
    k.q = b->def.integrator == SFEM_PQR ? b->def.q : 1;
    k.r = b->def.integrator == SFEM_PQR ? b->def.r : 1;
    if (b->def.integrator == SFEM_NEWMARK) k.q = 2 * b->def.gamma;
    return k;
}

/* out = load[0] F+ + load[1] F + load[2] F- + their sum M g - rhs; out may be rhs. */
static void sfemi_body_take_from_load(const sfem_body *b, const sfem_real load[3], const sfem_real *rhs,
                                      sfem_real *out)
{
    const sfem_model *model = b->model;
    const size_t n = 3 * (size_t)model->mesh.nodes;
    const sfem_real all = load[0] + load[1] + load[2], *g = b->state.head->gravity;
    const sfem_real *f0 = b->state.force[0], *f1 = b->state.force[1], *f2 = b->state.force[2];
    size_t i;
    for (i = 0; i < n / 3; ++i) {
        const sfem_real m = all * model->node_mass[i];
        out[3 * i] = m * g[0] - rhs[3 * i];
        out[3 * i + 1] = m * g[1] - rhs[3 * i + 1];
        out[3 * i + 2] = m * g[2] - rhs[3 * i + 2];
    }
    if (b->state.head->loaded && b->state.head->load_age >= 2)
        for (i = 0; i < n; ++i) out[i] += all * f0[i];
    else if (b->state.head->loaded)
        for (i = 0; i < n; ++i) out[i] += load[0] * f0[i] + load[1] * f1[i] + load[2] * f2[i];
}

/* rhs = load[0] F+ + load[1] F + load[2] F- + their sum M g - K zk - M zm - (rest of D) zd. */
static void sfemi_body_residual(sfem_body *b, const sfem_real load[3], int with_mass)
{
    const sfem_model *model = b->model;
    size_t i;
    sfem_matrix_multiply(&model->stiffness, b->zk, b->rhs, &b->exec);
    sfemi_body_take_from_load(b, load, b->rhs, b->rhs);
    if (with_mass) sfemi_fem_add_mass(model, -1, b->zm, b->rhs);
    if (model->damping) {
        for (i = 0; i < 3 * (size_t)model->mesh.nodes; ++i) b->zd[i] = -b->zd[i];
        sfemi_fem_add_damping_rest(model, b->zd, b->rhs);
    }
}

/* z = r over the lumped mass on the free axes, less what would move the handles' points. What pins and
 * handles take up is dropped from r, too: it would never shrink. Returns r.z. */
static sfem_real sfemi_body_lumped_solve(sfem_body *b, sfem_real *r, sfem_real *z)
{
    const sfem_model *model = b->model;
    const size_t n = 3 * (size_t)model->mesh.nodes;
    sfem_real rz = 0;
    size_t i;
    for (i = 0; i < n; ++i)
        z[i] = b->mask[i / 3] >> (i % 3) & 1 ? 0 : r[i] / model->node_mass[i / 3];
    if (b->grip.count) {
        memset(b->grip.lambda, 0, 3 * (size_t)b->grip.count * sizeof *b->grip.lambda);
        sfemi_grip_project(&b->grip, b->state.handle, model, b->mask, z);
    }
    for (i = 0; i < n; ++i) {
        r[i] = model->node_mass[i / 3] * z[i];
        rz += r[i] * z[i];
    }
    return rz;
}

/* Solves M a = rhs on the free axes, the handles' points held; a consistent M by conjugate gradients to
 * rounding, preconditioned by the lumped one (the condition is below 20, whatever the mesh), projected
 * onto the handles' null space [Gould, Hribar, Nocedal 2001]. Uses rhs, acc, zk, zm as scratch. */
static void sfemi_body_mass_solve(sfem_body *b, sfem_real *a)
{
    const sfem_model *model = b->model;
    const size_t n = 3 * (size_t)model->mesh.nodes;
    sfem_real *r = b->rhs, *z = b->acc, *p = b->zk, *ap = b->zm, rz, rz0;
    size_t i;
    int k;
    rz = rz0 = sfemi_body_lumped_solve(b, r, model->block_mass ? z : a);
    if (!model->block_mass) return;
    memcpy(p, z, n * sizeof *p);
    memset(a, 0, n * sizeof *a);
    for (k = 0; k < 200 && rz > 1e-32 * rz0; ++k) {
        sfem_real pap = 0, length, next;
        sfem_model_multiply_mass(model, p, ap, &b->exec);
        for (i = 0; i < n; ++i) pap += p[i] * ap[i];
        length = rz / pap;
        for (i = 0; i < n; ++i) {
            a[i] += length * p[i];
            r[i] -= length * ap[i];
        }
        next = sfemi_body_lumped_solve(b, r, z);
        for (i = 0; i < n; ++i) p[i] = z[i] + next / rz * p[i];
        rz = next;
    }
}

/* a0 = (scale M)^-1 (F - K u - D v), the acceleration at the start; zero where pins and handles hold. */
static void sfemi_body_initial_acceleration(sfem_body *b, sfem_real scale)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_real load[3] = {0, 1, 0};
    const sfem_real *u = b->state.u, *v = b->state.w;
    size_t i;
    for (i = 0; i < n; ++i) {
        b->zk[i] = u[i] + b->beta * v[i];
        b->zm[i] = b->alpha * v[i];
        if (b->zd) b->zd[i] = v[i];
    }
    sfemi_body_residual(b, load, b->alpha != 0);
    sfemi_body_mass_solve(b, b->state.a);
    for (i = 0; i < n; ++i) b->state.a[i] /= scale;
}

/* c - (what the handles would do without force), in units of acceleration, to g->lambda:
 * (target - H X - H u)/scale with u the displacement that is predicted. */
static void sfemi_body_handle_gap(const sfem_body *b, sfemi_grip *g, const sfem_real *u, sfem_real scale)
{
    sfem_int i;
    int c;
    for (i = 0; i < g->count; ++i) {
        const sfemi_handle *h = b->state.handle + g->slot[i];
        sfem_real rest[3], moved[3];
        sfemi_grip_mean(h, b->model->mesh.x, rest);
        sfemi_grip_mean(h, u, moved);
        for (c = 0; c < 3; ++c)
            g->lambda[3 * i + c] = (h->hold.target[c] - rest[c] - moved[c]) / scale;
    }
}

/* ============================================================================================
 * >>newmark   implicit Newmark                                                   [Newmark 1959]
 *
 *   (M + gamma h D + beta h^2 K) a' = F' - D v~ - K u~
 *   u~ = u + h v + h^2 (1/2 - beta) a,  v~ = v + (1 - gamma) h a;  u' = u~ + beta h^2 a',  v' = v~ + gamma h a'
 *
 * Held nodes and handles: the constraint on u' alone makes v and a ring with growing amplitude for
 * beta = 1/4, gamma = 1/2 (a' = -a - 4 v/h, a double root at -1). Their v' and a' are therefore taken from
 * three positions of the target, and the rest of the body follows by the least change in the mass norm.
 * ============================================================================================ */

/* The predictors of one axis. */
static void sfemi_newmark_guess(const sfem_body *b, size_t i, sfem_real h, sfem_real *u, sfem_real *v)
{
    const sfemi_state *s = &b->state;
    *u = s->u[i] + h * (s->w[i] + h * (0.5 - b->def.beta) * s->a[i]);
    *v = s->w[i] + (1 - b->def.gamma) * h * s->a[i];
}

static void sfemi_newmark_predict(sfem_body *b, sfem_real h)
{
    const sfem_real load[3] = {1, 0, 0};
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_int k;
    size_t i;
    int c, with_mass = b->alpha != 0;
    if (b->state.head->started != SFEMI_RUNNING) sfemi_body_initial_acceleration(b, 1);
    for (i = 0; i < n; ++i) {
        sfem_real u, v;
        sfemi_newmark_guess(b, i, h, &u, &v);
        b->zk[i] = u + b->beta * v;
        b->zm[i] = b->alpha * v;
        if (b->zd) b->zd[i] = v;
        b->acc[i] = 0;
    }
    for (k = 0; k < b->pin_count; ++k) {
        const size_t at = 3 * (size_t)b->pin[k];
        sfem_real x[3], v[3], a[3];
        for (c = 0; c < 3; ++c) x[c] = b->model->mesh.x[at + (size_t)c] + b->state.u[at + (size_t)c];
        sfemi_hold_motion(b->state.pin + k, x, h, b->state.head->h, v, a);
        for (c = 0; c < 3; ++c) {
            i = at + (size_t)c;
            if (!(b->mask[b->pin[k]] >> c & 1)) continue;
            b->zk[i] = b->state.pin[k].target[c] - b->model->mesh.x[i] + b->beta * v[c];
            b->zm[i] = b->alpha * v[c] + a[c];
            if (b->zd) b->zd[i] = v[c];
            b->acc[i] = a[c];
            with_mass |= b->model->block_mass != NULL && a[c] != 0;
        }
    }
    sfemi_body_residual(b, load, with_mass);
}

static void sfemi_newmark_solve(sfem_body *b)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real h = b->step;
    size_t i;
    sfem_real v;
    if (!b->grip.count) return;
    for (i = 0; i < n; ++i) sfemi_newmark_guess(b, i, h, &b->zk[i], &v);
    sfemi_body_handle_gap(b, &b->grip, b->zk, b->def.beta * h * h);
    sfemi_grip_apply(&b->grip, b->state.handle, b->model->mesh.nodes, b->acc);
}

static void sfemi_newmark_finish(sfem_body *b)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real h = b->step;
    sfemi_state *s = &b->state;
    sfem_int k;
    size_t i;
    int c;
    for (i = 0; i < n; ++i) {
        sfem_real u, v;
        if (b->mask[i / 3] >> (i % 3) & 1) continue;
        sfemi_newmark_guess(b, i, h, &u, &v);
        s->u[i] = u + b->def.beta * h * h * b->acc[i];
        s->w[i] = v + b->def.gamma * h * b->acc[i];
        s->a[i] = b->acc[i];
    }
    for (k = 0; k < b->pin_count; ++k) {
        const size_t at = 3 * (size_t)b->pin[k];
        sfem_real x[3], v[3], a[3];
        for (c = 0; c < 3; ++c) x[c] = b->model->mesh.x[at + (size_t)c] + s->u[at + (size_t)c];
        sfemi_hold_motion(s->pin + k, x, h, s->head->h, v, a);
        for (c = 0; c < 3; ++c) {
            if (!(b->mask[b->pin[k]] >> c & 1)) continue;
            s->u[at + (size_t)c] = s->pin[k].target[c] - b->model->mesh.x[at + (size_t)c];
            s->w[at + (size_t)c] = v[c];
            s->a[at + (size_t)c] = a[c];
        }
        sfemi_hold_advance(s->pin + k, x);
    }
}

/* Velocity and acceleration of the handles: x [handles][3] are their positions before the step. */
static void sfemi_newmark_settle_handles(sfem_body *b, const sfem_real *x)
{
    sfem_real *const array[2] = {b->state.w, b->state.a};
    sfem_int i;
    int c, pass;
    for (pass = 0; pass < 2 && b->grip.count; ++pass) {
        for (i = 0; i < b->grip.count; ++i) {
            sfem_real motion[2][3];
            sfemi_hold_motion(&b->state.handle[b->grip.slot[i]].hold, x + 3 * i, b->step,
                              b->state.head->h, motion[0], motion[1]);
            for (c = 0; c < 3; ++c) b->grip.lambda[3 * i + c] = motion[pass][c];
        }
        sfemi_grip_project(&b->grip, b->state.handle, b->model, b->mask, array[pass]);
    }
}

/* ============================================================================================
 * >>implicit   Newton: nonlinear Newmark, backward Euler, HHT, generalized-alpha, Bathe, statics
 *
 * Every method is one or two stages of one form, in the displacement d = u' - u over the step:
 *
 *   m1 M a' + m0 M a + D(w1 v' + w0 v) + f(u + w1 d) = F_w,    v' = c1 d + V,    a' = c2 d + A
 *
 * with V, A known: they are algorithm 1 of [Yuan et al. 2017] as meant, with other numbers. At a pin d, v'
 * and a' are given (see >>newmark); V and A are set so that the two maps hold there, too. Newton's matrix is
 *
 *   J = (m1 c2 + w1 c1 alpha) M + w1 (1 + c1 beta) K(u + w1 d) + w1 c1 (rest of D),
 *
 * which leaves out how beta K(u) v changes with u. J delta = F - M .. - D - f =: r. Where J is symmetric r is
 * minus the gradient of Psi(u + w1 d)/w1 + a part that is quadratic in d, so that the change of that
 * potential over delta is known without cancellation: the first by the energies, the second as the mean
 * of its slopes at both ends. A nonlinear damping force enters in the same way, to third order.
 * Handles: multipliers l with H (u + d) = target, by the Schur complement on the factor of the moment.
 * ============================================================================================ */

/* Do all tets follow Hooke's law in small rotations? */
static int sfemi_implicit_linear(const sfem_model *model) { return !model->turns; }

static sfem_status sfemi_implicit_check(const sfem_body_def *d, sfem_error *err)
{
    const sfem_newton_def *n = &d->newton;
    if (!(d->rho_inf >= 0 && d->rho_inf <= 1))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "rho_inf is %g, must be 0 to 1", d->rho_inf);
    if (!(d->hht_alpha >= 0 && d->hht_alpha <= 1. / 3))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "HHT's alpha is %g, must be 0 to 1/3", d->hht_alpha);
    if (n->iterations < 1)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "Newton's iterations are %d, must be >= 1", (int)n->iterations);
    if (!(sfemi_finite(n->tolerance) && n->tolerance >= 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "Newton's tolerance is %g, must be >= 0", n->tolerance);
    if ((unsigned)n->tangent > SFEM_TANGENT_FROZEN)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "there is no tangent %d", (int)n->tangent);
    if (n->load_steps < 1 || n->load_steps > 1000000)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "load_steps is %d, must be 1 to 1000000", (int)n->load_steps);
    if (d->damping_force.tangent && !d->damping_force.force)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "the damping force has a tangent, but no force");
    if (d->damping_force.force && (d->integrator == SFEM_PQR || d->integrator == SFEM_CENTRAL))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "a damping force needs an implicit integrator");
    return SFEM_OK;
}

/* Is a step of this body solved here? */
static int sfemi_implicit_serves(const sfem_body *b)
{
    if (b->def.integrator == SFEM_NEWMARK)
        return !sfemi_implicit_linear(b->model) || b->def.damping_force.force != NULL;
    return b->def.integrator >= SFEM_BACKWARD_EULER && b->def.integrator <= SFEM_BATHE;
}

/* Does Newton's matrix never change, so that a shared factor serves? */
static int sfemi_implicit_constant(const sfem_body *b)
{
    return sfemi_implicit_linear(b->model) && !b->def.damping_force.tangent;
}

/* The energy at u, and its gradient. */
static sfem_real sfemi_implicit_forces(sfem_body *b, const sfem_real *u, sfem_real *f)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_real energy = 0;
    size_t i;
    if (!sfemi_implicit_linear(b->model))
        return sfem_model_forces(b->model, u, SFEM_DOUBLE, f, NULL, NULL, b->implicit.work, &b->exec);
    sfem_matrix_multiply(&b->model->stiffness, u, f, &b->exec);
    for (i = 0; i < n; ++i) energy += u[i] * f[i];
    return energy / 2;
}

/* K(u), to tangent. */
static void sfemi_implicit_tangent(sfem_body *b, const sfem_real *u, sfem_tangent kind)
{
    if (!sfemi_implicit_linear(b->model))
        sfem_model_tangent(b->model, u, kind, &b->implicit.tangent, &b->exec);
}

static int sfemi_implicit_damped(const sfem_body *b)
{
    return b->alpha != 0 || b->beta != 0 || b->model->damping || b->def.damping_force.force;
}

/* Room for all that a step or a static solution works on; the tangent is a matrix of its own only where it
 * changes. */
static sfem_status sfemi_implicit_reserve(sfem_body *b, sfem_error *err)
{
    const sfem_model *model = b->model;
    const size_t n = 3 * (size_t)model->mesh.nodes, values = 9 * (size_t)model->row[model->mesh.nodes];
    sfemi_implicit *m = &b->implicit;
    sfem_real *memory = NULL, *tangent = NULL, *drag = NULL, *work = NULL, *at;
    sfem_status status = SFEM_OK;
    if (m->memory) return SFEM_OK;
    SFEMI_NEW(sfem_real, memory, &b->allocator, SFEMI_IMPLICIT_VECTORS * n);
    if (!sfemi_implicit_linear(model)) {
        SFEMI_NEW(sfem_real, tangent, &b->allocator, values);
        SFEMI_NEW(sfem_real, work, &b->allocator, sfem_model_work_size(model));
    }
    if (b->def.damping_force.tangent) SFEMI_NEW(sfem_real, drag, &b->allocator, values);
    m->tangent = m->drag = model->stiffness;
    if (tangent) m->tangent.val = tangent;
    m->drag.val = drag;
    at = m->memory = memory;
    m->work = work;
    m->d = at, at += n;
    m->best = at, at += n;
    m->goal = at, at += n;
    m->vmap = at, at += n;
    m->amap = at, at += n;
    m->a0 = at, at += n;
    m->load = at, at += n;
    m->f = at, at += n;
    m->q = at, at += n;
    m->x = at, at += n;
    m->v = at, at += n;
    m->step = at, at += n;
    m->mid_d = at, at += n;
    m->mid_v = at, at += n;
    m->mid_a = at;
    return SFEM_OK;
done:
    sfemi_delete(&b->allocator, work);
    sfemi_delete(&b->allocator, tangent);
    sfemi_delete(&b->allocator, memory);
    return status;
}

static void sfemi_system_close(const sfem_body *b, sfemi_system *s)
{
    sfem_matrix_free(&s->matrix, &b->model->allocator);
    sfemi_delete(&b->model->allocator, s->source);
    memset(s, 0, sizeof *s);
}

static void sfemi_implicit_destroy(sfem_body *b)
{
    sfemi_implicit *m = &b->implicit;
    sfemi_system_close(b, &m->system);
    sfemi_factor_release(b->model, m->second);
    if (m->memory && m->tangent.val != b->model->stiffness.val)
        sfemi_delete(&b->allocator, m->tangent.val);
    sfemi_delete(&b->allocator, m->drag.val);
    sfemi_delete(&b->allocator, m->work);
    sfemi_delete(&b->allocator, m->memory);
}

static size_t sfemi_implicit_bytes(const sfem_body *b)
{
    const sfemi_implicit *m = &b->implicit;
    const size_t values = 9 * (size_t)b->model->row[b->model->mesh.nodes];
    size_t reals = 0;
    if (m->memory) {
        reals = 3 * SFEMI_IMPLICIT_VECTORS * (size_t)b->model->mesh.nodes;
        if (m->tangent.val != b->model->stiffness.val) reals += values;
        if (m->drag.val) reals += values;
    }
    if (m->system.matrix.val) reals += 9 * (size_t)m->system.matrix.row[m->system.matrix.n];
    return reals * sizeof(sfem_real);
}

/* A factor of its own and the matrix to refactor it from. The caller releases the factor. */
static sfem_status sfemi_system_open(sfem_body *b, const sfemi_factor_key *key, sfemi_system *out,
                                     sfem_error *err)
{
    const sfem_model *model = b->model;
    sfemi_system s;
    sfem_status status = SFEM_OK;
    sfem_int k, at, count = 0;
    memset(&s, 0, sizeof s);
    SFEMI_TRY(sfemi_factor_make(b->model, key, &b->exec, &s.factor, err));
    ++b->factors_made;
    SFEMI_TRY(sfemi_factor_matrix(model, s.factor, &s.matrix, err));
    SFEMI_NEW(sfem_int, s.source, &model->allocator, (size_t)s.matrix.row[s.matrix.n] + 1);
    for (k = 0; k < s.factor->free_nodes; ++k)
        for (at = model->row[s.factor->node[k]]; at < model->row[s.factor->node[k] + 1]; ++at)
            if (s.factor->mask[model->col[at]] != SFEM_AXIS_ALL) s.source[count++] = at;
    *out = s;
    return SFEM_OK;
done:
    sfemi_factor_release(b->model, s.factor);
    sfemi_system_close(b, &s);
    return status;
}

/* ---- stages ---- */

static int sfemi_implicit_stages(const sfem_body *b) { return b->def.integrator == SFEM_BATHE ? 2 : 1; }

/* The numbers of stage k of a step of h seconds. */
static sfemi_stage sfemi_implicit_stage(const sfem_body *b, int k, sfem_real h)
{
    sfem_real beta = b->def.beta, gamma = b->def.gamma, am = 0, af = 0;
    sfemi_stage s;
    memset(&s, 0, sizeof s);
    s.end = 1;
    if (b->def.integrator == SFEM_HHT) {
        af = b->def.hht_alpha;
    } else if (b->def.integrator == SFEM_GENERALIZED_ALPHA) {
        const sfem_real rho = b->def.rho_inf;
        am = (2 * rho - 1) / (rho + 1);
        af = rho / (rho + 1);
    }
    if (b->def.integrator != SFEM_NEWMARK) {
        gamma = 0.5 - am + af;
        beta = (1 - am + af) * (1 - am + af) / 4;
    }
    s.m1 = 1 - am;
    s.m0 = am;
    s.w1 = 1 - af;
    s.w0 = af;
    if (b->def.integrator == SFEM_BACKWARD_EULER) {
        s.c1 = 1 / h;
        s.c2 = 1 / (h * h);
        s.av = -1 / h;
        return s;
    }
    if (b->def.integrator == SFEM_BATHE && k == 1) {
        s.c1 = 3 / h; /* v' = (u - 4 u_mid + 3 u')/h, and a' from v alike */
        s.vd = -4 / h;
        s.c2 = 9 / (h * h);
        s.av = 1 / h;
        s.ad = -12 / (h * h);
        s.am = -4 / h;
        return s;
    }
    if (b->def.integrator == SFEM_BATHE) {
        s.end = 0.5;
        h /= 2;
    }
    s.c1 = gamma / (beta * h);
    s.vv = 1 - gamma / beta;
    s.va = (1 - gamma / (2 * beta)) * h;
    s.c2 = 1 / (beta * h * h);
    s.av = -1 / (beta * h);
    s.aa = 1 - 1 / (2 * beta);
    return s;
}

/* J of a stage at rest position, as a factor's key. */
static sfemi_factor_key sfemi_implicit_key(const sfem_body *b, int k, sfem_real h)
{
    const sfemi_stage s = sfemi_implicit_stage(b, k, h);
    sfemi_factor_key key;
    memset(&key, 0, sizeof key);
    key.ck = s.w1 * (1 + s.c1 * b->beta);
    key.cm = s.m1 * s.c2 + s.w1 * s.c1 * b->alpha;
    key.cd = b->model->damping ? s.w1 * s.c1 : 0;
    key.mask = b->mask;
    key.precision = b->def.precision;
    key.ordering = b->def.ordering;
    return key;
}

/* The factor for steps of h seconds, a reference for the caller: shared for a constant matrix (and the second
 * one kept), else the body's own, which serves any h. */
static sfem_status sfemi_implicit_get_factor(sfem_body *b, sfem_real h, sfem_factor **out, sfem_error *err)
{
    sfemi_implicit *m = &b->implicit;
    const sfemi_factor_key key = sfemi_implicit_key(b, 0, h);
    sfem_factor *second = NULL;
    sfemi_system system;
    sfem_status status;
    if (sfemi_implicit_constant(b)) {
        status = sfemi_factor_get(b->model, &key, &b->exec, out, &b->factors_made, err);
        if (status != SFEM_OK || sfemi_implicit_stages(b) == 1) return status;
        {
            const sfemi_factor_key other = sfemi_implicit_key(b, 1, h);
            status = sfemi_factor_get(b->model, &other, &b->exec, &second, &b->factors_made, err);
        }
        if (status != SFEM_OK) {
            sfemi_factor_release(b->model, *out);
            return status;
        }
        sfemi_factor_release(b->model, m->second);
        m->second = second;
        return SFEM_OK;
    }
    if (!b->factor) {
        status = sfemi_system_open(b, &key, &system, err);
        if (status != SFEM_OK) return status;
        sfemi_system_close(b, &m->system);
        m->system = system;
        *out = system.factor;
        return SFEM_OK;
    }
    *out = b->factor;
    sfemi_lock(&b->model->lock);
    ++b->factor->references;
    sfemi_unlock(&b->model->lock);
    return SFEM_OK;
}

/* Place, velocity and acceleration of something held, where the stage ends; x: where it is now. */
static void sfemi_implicit_hold(const sfem_body *b, const sfemi_hold *hold, const sfem_real *x,
                                sfem_real place[3], sfem_real v[3], sfem_real a[3])
{
    const sfem_real back = (1 - b->implicit.stage.end) * b->step;
    int c;
    sfemi_hold_motion(hold, x, b->step, b->state.head->h, v, a);
    for (c = 0; c < 3; ++c) {
        place[c] = hold->target[c] - back * (v[c] - back / 2 * a[c]);
        v[c] -= back * a[c];
    }
}

/* V, A, and at pins d itself. */
static void sfemi_implicit_history(sfem_body *b)
{
    sfemi_implicit *m = &b->implicit;
    const sfemi_stage *s = &m->stage;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real *v = b->state.w;
    sfem_int k;
    size_t i;
    int c;
    for (i = 0; i < n; ++i) {
        m->vmap[i] = s->vv * v[i] + s->va * m->a0[i] + s->vd * m->mid_d[i];
        m->amap[i] = s->av * v[i] + s->aa * m->a0[i] + s->ad * m->mid_d[i] + s->am * m->mid_v[i];
        m->goal[i] = 0;
    }
    for (k = 0; k < b->pin_count; ++k) {
        const size_t at = 3 * (size_t)b->pin[k];
        const sfem_real *rest = b->model->mesh.x + at, *u = b->state.u + at;
        sfem_real x[3], place[3], pv[3], pa[3];
        for (c = 0; c < 3; ++c) x[c] = rest[c] + u[c];
        sfemi_implicit_hold(b, b->state.pin + k, x, place, pv, pa);
        for (c = 0; c < 3; ++c) {
            if (!(b->mask[b->pin[k]] >> c & 1)) continue;
            i = at + (size_t)c;
            m->goal[i] = place[c] - rest[c] - u[c];
            m->vmap[i] = pv[c] - s->c1 * m->goal[i];
            m->amap[i] = pa[c] - s->c2 * m->goal[i];
        }
    }
}

/* ---- what is balanced ---- */

/* f = f(u), q = M a + D(v), v and a NULL: zero. Returns the energy at u. v may be overwritten. */
static sfem_real sfemi_implicit_terms(sfem_body *b, const sfem_real *u, const sfem_real *v,
                                      const sfem_real *a, sfem_real *f, sfem_real *q)
{
    const sfem_damping_force *drag = &b->def.damping_force;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real energy = sfemi_implicit_forces(b, u, f);
    size_t i;
    b->implicit.tangent_ready = 0;
    memset(q, 0, n * sizeof *q);
    if (v && b->beta != 0) {
        sfemi_implicit_tangent(b, u, b->def.newton.tangent);
        b->implicit.tangent_ready = 1;
        sfem_matrix_multiply(&b->implicit.tangent, v, q, &b->exec);
        for (i = 0; i < n; ++i) q[i] *= b->beta;
    }
    if (a) sfemi_fem_add_mass(b->model, 1, a, q);
    if (v && b->alpha != 0) sfemi_fem_add_mass(b->model, b->alpha, v, q);
    if (v) sfemi_fem_add_damping_rest(b->model, v, q);
    if (v && drag->force) drag->force(drag->user, v, q);
    return energy;
}

/* load = F+ + share (F - F+) + M g, the load at a time between the start and the end of the step. */
static void sfemi_implicit_load(const sfem_body *b, sfem_real share, sfem_real *load)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfemi_state *s = &b->state;
    size_t i;
    for (i = 0; i < n; ++i) load[i] = b->model->node_mass[i / 3] * s->head->gravity[i % 3];
    if (!s->head->loaded) return;
    for (i = 0; i < n; ++i) load[i] += s->force[0][i];
    if (s->head->load_age >= 2 || share == 0) return;
    for (i = 0; i < n; ++i) load[i] += share * (s->force[1][i] - s->force[0][i]);
}

/* r = F - M a - D(v) - f(u) in the present state, under the load at the start (share 1) or end (0) of the
 * next step. */
static void sfemi_implicit_balance(sfem_body *b, sfem_real share, const sfem_real *v, const sfem_real *a,
                                   sfem_real *r)
{
    sfemi_implicit *m = &b->implicit;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    size_t i;
    sfemi_implicit_terms(b, b->state.u, v, a, m->f, m->q);
    sfemi_implicit_load(b, share, r);
    for (i = 0; i < n; ++i) r[i] -= m->f[i] + m->q[i];
}

/* ---- Newton ---- */

/* Where Newton's iteration stands. */
typedef struct sfemi_newton {
    sfemi_system *system;
    const char *what;    /* "the step" */
    sfem_int iterations; /* at most */
    int once;            /* one solve, whatever comes of it */
    int ready;           /* d is evaluated */
    int feasible;        /* pins and handles are where they have to be */
    sfem_real scale;     /* what |r| is compared with */
    sfem_real floor_u, floor_d, edge; /* |r| that rounding makes of displacements, see below */
    sfem_real best;      /* the least relative |r| so far, that of implicit.best */
} sfemi_newton;

static sfem_real sfemi_implicit_dot(const sfem_real *a, const sfem_real *b, size_t n)
{
    sfem_real sum = 0;
    size_t i;
    for (i = 0; i < n; ++i) sum += a[i] * b[i];
    return sum;
}

static sfem_real sfemi_implicit_max(const sfem_real *a, size_t n)
{
    sfem_real most = 0;
    size_t i;
    for (i = 0; i < n; ++i)
        if (fabs(a[i]) > most) most = fabs(a[i]);
    return most;
}

/* Below what |r| is noise: gradients of displacements carry an error of eps (|u|/edge + 1), so that a
 * node's force is uncertain by eps K_ii (|u| + edge); inertia by eps M c2 |d|. */
static void sfemi_newton_floor(sfem_body *b, sfemi_newton *t)
{
    const sfem_model *model = b->model;
    const sfem_real eps = 2.3e-16;
    sfem_real k2 = 0, m2 = 0, volume = 0;
    sfem_int i;
    int c;
    for (i = 0; i < model->mesh.nodes; ++i) {
        const sfem_real *k = model->stiffness.val + 9 * ((size_t)model->row[i + 1] - 1);
        for (c = 0; c < 3; ++c) k2 += k[4 * c] * k[4 * c];
        m2 += 3 * model->node_mass[i] * model->node_mass[i];
    }
    for (i = 0; i < model->mesh.tets; ++i) volume += model->volume[i];
    t->edge = pow(volume / model->mesh.tets, 1. / 3);
    t->floor_u = eps * sqrt(k2);
    t->floor_d = b->implicit.still ? 0 : eps * b->implicit.stage.m1 * b->implicit.stage.c2 * sqrt(m2);
}

/* f and q = M .. + D - F at d, zero on held axes; the scale of r. */
static void sfemi_newton_evaluate(sfem_body *b, sfemi_newton *t)
{
    sfemi_implicit *m = &b->implicit;
    const sfemi_stage *s = &m->stage;
    const unsigned char *mask = t->system->factor->mask;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_real *a = b->zm, most[4] = {0, 0, 0, 0};
    size_t i;
    for (i = 0; i < n; ++i) {
        m->x[i] = b->state.u[i] + s->w1 * m->d[i];
        if (m->still) continue;
        m->v[i] = s->w1 * (s->c1 * m->d[i] + m->vmap[i]) + s->w0 * b->state.w[i];
        a[i] = s->m1 * (s->c2 * m->d[i] + m->amap[i]) + s->m0 * m->a0[i];
    }
    m->energy = sfemi_implicit_terms(b, m->x, m->still || !sfemi_implicit_damped(b) ? NULL : m->v, NULL,
                                     m->f, m->q);
    memset(b->zk, 0, n * sizeof *b->zk);
    if (!m->still) sfemi_fem_add_mass(b->model, 1, a, b->zk);
    for (i = 0; i < n; ++i) {
        if (mask[i / 3] >> (i % 3) & 1) {
            m->f[i] = m->q[i] = 0;
            continue;
        }
        most[0] += m->f[i] * m->f[i];
        most[1] += m->q[i] * m->q[i];
        most[2] += b->zk[i] * b->zk[i];
        most[3] += m->load[i] * m->load[i];
        m->q[i] += b->zk[i] - m->load[i];
    }
    for (i = 1; i < 4; ++i)
        if (most[i] > most[0] || !sfemi_finite(most[i])) most[0] = most[i];
    t->scale = sqrt(most[0]);
    ++m->info.evaluations;
}

static int sfemi_newton_finite(const sfem_body *b, const sfemi_newton *t)
{
    return sfemi_finite(b->implicit.energy) && sfemi_finite(t->scale);
}

/* The norm of r + H^T l, l in grip.lambda, and whether it will do. */
static int sfemi_newton_converged(sfem_body *b, sfemi_newton *t)
{
    sfemi_implicit *m = &b->implicit;
    const sfemi_grip *g = &b->grip;
    const unsigned char *mask = t->system->factor->mask;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_real floor, norm;
    sfem_int k;
    size_t i;
    int p, c;
    for (i = 0; i < n; ++i) m->step[i] = -(m->f[i] + m->q[i]);
    for (k = 0; k < g->count; ++k) {
        const sfemi_handle *h = b->state.handle + g->slot[k];
        for (p = 0; p < 4; ++p)
            for (c = 0; c < 3; ++c)
                if (h->weight[p] != 0 && !(mask[h->node[p]] >> c & 1))
                    m->step[3 * (size_t)h->node[p] + (size_t)c] += h->weight[p] * g->lambda[3 * k + c];
    }
    norm = sqrt(sfemi_implicit_dot(m->step, m->step, n));
    floor = t->floor_u * (sfemi_implicit_max(m->x, n) + t->edge) +
            t->floor_d * sfemi_implicit_max(m->d, n);
    m->info.residual = t->scale > 0 ? norm / t->scale : 0;
    if (!t->feasible) return 0;
    if (b->def.newton.accept_best && !m->still && m->info.residual < t->best) {
        t->best = m->info.residual;
        memcpy(m->best, m->d, n * sizeof *m->d);
    }
    return norm <= floor || norm <= b->def.newton.tolerance * t->scale;
}

/* The stage's J at the last evaluation, plus shift M, into the system's factor. */
static sfem_status sfemi_newton_factor(sfem_body *b, sfemi_newton *t, sfem_tangent kind, sfem_real shift,
                                       sfem_error *err)
{
    sfemi_implicit *m = &b->implicit;
    const sfemi_stage *s = &m->stage;
    const sfem_model *model = b->model;
    const sfemi_system *y = t->system;
    const size_t values = 9 * (size_t)model->row[model->mesh.nodes];
    sfem_int k, at = 0;
    sfem_error place;
    sfem_status status;
    int r, c;
    if (!y->matrix.val) return SFEM_OK;
    if (!m->tangent_ready || kind != b->def.newton.tangent) sfemi_implicit_tangent(b, m->x, kind);
    m->tangent_ready = kind == b->def.newton.tangent;
    if (m->drag.val && !m->still) {
        memset(m->drag.val, 0, values * sizeof *m->drag.val);
        b->def.damping_force.tangent(b->def.damping_force.user, m->v, &m->drag);
    }
    for (k = 0; k < y->matrix.n; ++k) {
        const sfem_int i = y->factor->node[k];
        for (; at < y->matrix.row[k + 1]; ++at) {
            const size_t from = 9 * (size_t)y->source[at];
            const sfem_int j = model->col[y->source[at]];
            const int held = y->factor->mask[i] | y->factor->mask[j];
            const sfem_real mass = model->block_mass ? model->block_mass[y->source[at]]
                                   : i == j       ? model->node_mass[i]
                                                  : 0;
            const sfem_real ck = s->w1 * (1 + s->c1 * b->beta), cd = s->w1 * s->c1;
            const sfem_real cm = (s->m1 * s->c2 + cd * b->alpha + shift) * mass;
            sfem_real *to = y->matrix.val + 9 * (size_t)at;
            for (c = 0; c < 9; ++c) to[c] = ck * m->tangent.val[from + (size_t)c];
            for (c = 0; c < 9; c += 4) to[c] += cm;
            if (model->damping && cd != 0)
                for (c = 0; c < 9; ++c) to[c] += cd * model->damping[from + (size_t)c];
            if (m->drag.val && cd != 0)
                for (c = 0; c < 9; ++c) to[c] += cd * m->drag.val[from + (size_t)c];
            for (r = 0; held && r < 3; ++r)
                for (c = 0; c < 3; ++c) {
                    if (!(y->factor->mask[i] >> r & 1) && !(y->factor->mask[j] >> c & 1)) continue;
                    if (i != j || r != c) to[3 * r + c] = 0;
                    else to[3 * r + c] = model->stiffness.val[from + (size_t)(4 * r)];
                }
        }
    }
    ++m->info.factorisations;
    if (!y->factor->ldl) return SFEM_OK;
    status = sfem_ldl_refactor(y->factor->ldl, &y->matrix, &place);
    if (status == SFEM_OK || !err) return status;
    if (place.node >= 0) place.node = y->factor->node[place.node];
    return sfemi_fail_at(err, status, place.node, -1, "%s's matrix is %s at node %d", t->what,
                         status == SFEM_NOT_SPD ? "not positive definite" : "not finite", (int)place.node);
}

/* A factor of J. One that is not positive definite gets more of its own mass, which disturbs the other modes
 * less than projecting every tet, and then the projected K; and where nothing but K is in J (statics), that and
 * a little mass to make up for flat directions. */
static sfem_status sfemi_newton_matrix(sfem_body *b, sfemi_newton *t, int project, sfem_error *err)
{
    const sfem_tangent kind = project ? SFEM_TANGENT_PSD : b->def.newton.tangent;
    const sfem_real inertia = b->implicit.still ? 0 : b->implicit.stage.m1 * b->implicit.stage.c2;
    sfem_status status = sfemi_newton_factor(b, t, kind, 0, err);
    sfem_real shift;
    int tries;
    if (status != SFEM_NOT_SPD || sfemi_implicit_linear(b->model)) return status;
    if (kind == SFEM_TANGENT_EXACT) {
        ++b->implicit.info.projected;
        for (shift = inertia / 8; shift > 0 && shift < inertia && status == SFEM_NOT_SPD; shift *= 4)
            status = sfemi_newton_factor(b, t, kind, shift, err);
        if (status == SFEM_NOT_SPD) status = sfemi_newton_factor(b, t, SFEM_TANGENT_PSD, 0, err);
    }
    if (!b->implicit.still || !(b->model->total_mass > 0)) return status;
    shift = 1e-7 * t->floor_u / 2.3e-16 / b->model->total_mass; /* floor_u is eps |diag K| */
    for (tries = 0; tries < 3 && status == SFEM_NOT_SPD; ++tries, shift *= 100)
        status = sfemi_newton_factor(b, t, SFEM_TANGENT_PSD, shift, err);
    return status;
}

/* step -= J g, where g is what the held axes still have to go. */
static void sfemi_newton_lift(sfem_body *b, const sfem_real *g)
{
    sfemi_implicit *m = &b->implicit;
    const sfemi_stage *s = &m->stage;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real ck = s->w1 * (1 + s->c1 * b->beta), cd = s->w1 * s->c1;
    size_t i;
    sfem_matrix_multiply(&m->tangent, g, b->zk, &b->exec);
    for (i = 0; i < n; ++i) m->step[i] -= ck * b->zk[i];
    sfemi_fem_add_mass(b->model, -(s->m1 * s->c2 + cd * b->alpha), g, m->step);
    if (cd == 0) return;
    if (b->model->damping) {
        for (i = 0; i < n; ++i) b->zk[i] = -cd * g[i];
        sfemi_fem_add_damping_rest(b->model, b->zk, m->step);
    }
    if (!m->drag.val) return;
    sfem_matrix_multiply(&m->drag, g, b->zk, &b->exec);
    for (i = 0; i < n; ++i) m->step[i] -= cd * b->zk[i];
}

/* What the handles still have to go, to grip.lambda; the largest of it. */
static sfem_real sfemi_newton_gap(sfem_body *b)
{
    sfemi_implicit *m = &b->implicit;
    sfem_int k;
    int c;
    for (k = 0; k < b->grip.count; ++k) {
        const sfemi_handle *h = b->state.handle + b->grip.slot[k];
        sfem_real rest[3], u[3], d[3], place[3], v[3], a[3];
        sfemi_grip_mean(h, b->model->mesh.x, rest);
        sfemi_grip_mean(h, b->state.u, u);
        sfemi_grip_mean(h, m->d, d);
        for (c = 0; c < 3; ++c) place[c] = rest[c] + u[c];
        if (m->still) {
            for (c = 0; c < 3; ++c) v[c] = place[c] + m->share * (h->hold.target[c] - place[c]);
            memcpy(place, v, sizeof place);
        } else {
            sfemi_implicit_hold(b, &h->hold, place, place, v, a);
        }
        for (c = 0; c < 3; ++c) b->grip.lambda[3 * k + c] = place[c] - rest[c] - u[c] - d[c];
    }
    return sfemi_implicit_max(b->grip.lambda, 3 * (size_t)b->grip.count);
}

/* Newton's correction, to step; pins and handles go all their way. */
static sfem_status sfemi_newton_correct(sfem_body *b, sfemi_newton *t, int project, sfem_error *err)
{
    sfemi_implicit *m = &b->implicit;
    const sfemi_system *y = t->system;
    const sfem_int nodes = b->model->mesh.nodes;
    const size_t n = 3 * (size_t)nodes;
    sfem_real *g = b->acc;
    int moved = 0;
    sfem_int k;
    size_t i;
    const sfem_status status = sfemi_newton_matrix(b, t, project, err);
    if (status != SFEM_OK) return status;
    for (i = 0; i < n; ++i) {
        const int held = y->factor->mask[i / 3] >> (i % 3) & 1;
        m->step[i] = -(m->f[i] + m->q[i]);
        g[i] = held ? m->goal[i] - m->d[i] : 0;
        moved |= g[i] != 0;
    }
    if (moved) sfemi_newton_lift(b, g);
    sfemi_factor_solve(y->factor, nodes, 1, m->step, m->step, b->work, &b->exec);
    for (i = 0; i < n; ++i)
        if (y->factor->mask[i / 3] >> (i % 3) & 1) m->step[i] = g[i];
    ++m->info.iterations;
    if (!b->grip.count) return SFEM_OK;
    if (y->matrix.val || m->second) {
        for (k = 0; k < b->grip.count; ++k)
            sfemi_grip_columns(y->factor, b->state.handle + b->grip.slot[k], nodes, 0,
                               b->grip.y[b->grip.slot[k]], b->work, &b->exec);
        sfemi_grip_gather(&b->grip, b->state.handle, b->model, 0, y->factor->mask);
    }
    sfemi_newton_gap(b);
    sfemi_grip_apply(&b->grip, b->state.handle, nodes, m->step);
    return SFEM_OK;
}

/* l.(H step): nothing once the handles are where they belong, but for rounding, which l may make felt. */
static sfem_real sfemi_newton_handle_work(const sfem_body *b)
{
    sfem_real work = 0, mean[3];
    sfem_int k;
    for (k = 0; k < b->grip.count; ++k) {
        sfemi_grip_mean(b->state.handle + b->grip.slot[k], b->implicit.step, mean);
        work += sfemi_dot3(mean, b->grip.lambda + 3 * k);
    }
    return work;
}

/* Is the potential low enough at d + length step? drop, slope: minus its slopes at both ends; change: what
 * it has gained. Where the change drowns in rounding, the slope alone tells [Hager and Zhang 2005]. */
static int sfemi_newton_suffices(sfem_real change, sfem_real length, sfem_real drop, sfem_real slope,
                                 sfem_real noise)
{
    if (change <= -1e-4 * length * drop) return 1;
    return fabs(slope) <= 0.9 * drop && change <= noise;
}

/* Goes along step until that is better. 1: d is the new place and evaluated; 0: d is as it was, but what was
 * evaluated is not. */
static int sfemi_newton_search(sfem_body *b, sfemi_newton *t)
{
    sfemi_implicit *m = &b->implicit;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const int check = t->feasible && !b->def.newton.no_line_search;
    const sfem_real energy = m->energy, hands = sfemi_newton_handle_work(b);
    const sfem_real q0 = sfemi_implicit_dot(m->q, m->step, n) - hands;
    const sfem_real drop = -(q0 + sfemi_implicit_dot(m->f, m->step, n));
    sfem_real length = 1, gone = 0;
    size_t i;
    int tries;
    for (tries = 0; tries < 20; ++tries) {
        sfem_real change = 0, next = length / 4;
        for (i = 0; i < n; ++i) m->d[i] += (length - gone) * m->step[i];
        gone = length;
        sfemi_newton_evaluate(b, t);
        if (sfemi_newton_finite(b, t)) {
            const sfem_real q1 = sfemi_implicit_dot(m->q, m->step, n) - hands;
            const sfem_real slope = -(q1 + sfemi_implicit_dot(m->f, m->step, n));
            const sfem_real noise = 1e-10 * (fabs(energy) + fabs(m->energy)) / m->stage.w1;
            change = (m->energy - energy) / m->stage.w1 + length / 2 * (q0 + q1);
            if (!check || sfemi_newton_suffices(change, length, drop, slope, noise)) {
                t->feasible |= length == 1;
                return 1;
            }
            next = length * length * drop / (2 * (change + length * drop)); /* of the parabola */
            if (!(next < length / 2)) next = length / 2;
            if (!(next > length / 10)) next = length / 10;
        }
        length = next;
    }
    for (i = 0; i < n; ++i) m->d[i] -= gone * m->step[i];
    return 0;
}

/* One stage, from d on. */
static sfem_status sfemi_newton_run(sfem_body *b, sfemi_newton *t, sfem_error *err)
{
    sfemi_implicit *m = &b->implicit;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_int before = m->info.iterations;
    const unsigned char *mask = t->system->factor->mask;
    sfem_status status;
    size_t i;
    int project = 0;
    sfemi_newton_floor(b, t);
    if (!t->ready) sfemi_newton_evaluate(b, t);
    if (!sfemi_newton_finite(b, t))
        return sfemi_fail(err, SFEM_NOT_FINITE, "%s: a force is not finite", t->what);
    t->best = 1e300;
    t->feasible = !(sfemi_newton_gap(b) > 0);
    for (i = 0; i < n && t->feasible; ++i)
        t->feasible = !(mask[i / 3] >> (i % 3) & 1) || m->d[i] == m->goal[i];
    for (i = 0; i < (size_t)b->grip.count; ++i)
        memcpy(b->grip.lambda + 3 * i, b->state.handle[b->grip.slot[i]].force, 3 * sizeof(sfem_real));
    m->info.converged = 0;
    for (;;) {
        const int enough = sfemi_newton_converged(b, t);
        if (enough && !t->once) {
            m->info.converged = 1;
            return SFEM_OK;
        }
        if (m->info.iterations - before >= t->iterations) break;
        status = sfemi_newton_correct(b, t, project, err);
        if (status != SFEM_OK) return status;
        if (t->once) {
            for (i = 0; i < n; ++i) m->d[i] += m->step[i];
            if (sfemi_all_finite(m->d, n)) return SFEM_OK;
            return sfemi_fail(err, SFEM_NOT_FINITE, "%s: the displacement is not finite", t->what);
        }
        if (sfemi_newton_search(b, t)) {
            project = 0;
        } else {
            if (project) break;
            project = 1;
            sfemi_newton_evaluate(b, t);
        }
    }
    if (b->def.newton.accept_best && !m->still) {
        if (t->best < 1e300) memcpy(m->d, m->best, n * sizeof *m->d);
        return SFEM_OK;
    }
    return sfemi_fail(err, SFEM_NOT_CONVERGED, "%s did not converge: residual %.3g after %d iterations",
                      t->what, m->info.residual, (int)(m->info.iterations - before));
}

/* ---- a step ---- */

static void sfemi_implicit_predict(sfem_body *b)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfemi_implicit *m = &b->implicit;
    memset(m->mid_d, 0, n * sizeof *m->mid_d);
    memset(m->mid_v, 0, n * sizeof *m->mid_v);
    if (b->state.head->started == SFEMI_RUNNING) {
        memcpy(m->a0, b->state.a, n * sizeof *m->a0);
    } else if (b->def.integrator == SFEM_BACKWARD_EULER) {
        memset(m->a0, 0, n * sizeof *m->a0);
    } else {
        memcpy(m->v, b->state.w, n * sizeof *m->v);
        sfemi_implicit_balance(b, 1, m->v, NULL, b->rhs);
        sfemi_body_mass_solve(b, m->a0);
    }
    sfemi_implicit_load(b, 0, b->rhs);
}

/* Where to start from: the last place known, or that and v, a from there, whichever has less potential. */
static void sfemi_implicit_guess(sfem_body *b, sfemi_newton *t, int stage)
{
    sfemi_implicit *m = &b->implicit;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real *v = stage ? m->mid_v : b->state.w, *a = stage ? m->mid_a : m->a0;
    const sfem_real h = b->step * (stage ? 0.5 : m->stage.end);
    sfem_real energy, q0;
    size_t i;
    memcpy(m->d, m->mid_d, n * sizeof *m->d);
    if (t->once) return;
    sfemi_newton_evaluate(b, t);
    energy = m->energy;
    for (i = 0; i < n; ++i) m->step[i] = h * (v[i] + h / 2 * a[i]);
    q0 = sfemi_implicit_dot(m->q, m->step, n);
    for (i = 0; i < n; ++i) m->d[i] += m->step[i];
    sfemi_newton_evaluate(b, t);
    q0 += sfemi_implicit_dot(m->q, m->step, n);
    t->ready = sfemi_newton_finite(b, t) && (m->energy - energy) / m->stage.w1 + q0 / 2 <= 0;
    if (t->ready) return;
    memcpy(m->d, m->mid_d, n * sizeof *m->d);
}

/* All stages; leaves the acceleration at the end in acc, and d, v', a' in d, mid_v, mid_a. */
static sfem_status sfemi_implicit_solve(sfem_body *b, sfem_error *err)
{
    sfemi_implicit *m = &b->implicit;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const int stages = sfemi_implicit_stages(b);
    sfem_status status;
    size_t i;
    int k;
    memset(&m->info, 0, sizeof m->info);
    m->still = 0;
    m->system.factor = b->factor;
    for (k = 0; k < stages; ++k) {
        sfemi_system shared;
        sfemi_newton t;
        sfem_real share;
        memset(&t, 0, sizeof t);
        memset(&shared, 0, sizeof shared);
        shared.factor = k ? m->second : b->factor;
        t.system = m->system.matrix.val ? &m->system : &shared;
        t.what = "the step";
        t.iterations = b->def.newton.iterations;
        t.once = t.iterations == 1 ||
                 (sfemi_implicit_linear(b->model) && !b->def.damping_force.force);
        m->stage = sfemi_implicit_stage(b, k, b->step);
        share = 1 - m->stage.w1 * m->stage.end;
        memcpy(m->load, b->rhs, n * sizeof *m->load);
        if (share != 0 && b->state.head->loaded && b->state.head->load_age < 2)
            for (i = 0; i < n; ++i) m->load[i] += share * (b->state.force[1][i] - b->state.force[0][i]);
        sfemi_implicit_history(b);
        sfemi_implicit_guess(b, &t, k);
        status = sfemi_newton_run(b, &t, err);
        if (status != SFEM_OK) return status;
        memcpy(m->mid_d, m->d, n * sizeof *m->d);
        for (i = 0; i < n; ++i) {
            m->mid_v[i] = m->stage.c1 * m->d[i] + m->vmap[i];
            m->mid_a[i] = m->stage.c2 * m->d[i] + m->amap[i];
        }
    }
    if (!sfemi_all_finite(m->mid_a, n))
        return sfemi_fail(err, SFEM_NOT_FINITE, "the step's acceleration is not finite: a force was not");
    memcpy(b->acc, m->mid_a, n * sizeof *b->acc);
    return SFEM_OK;
}

static void sfemi_implicit_finish(sfem_body *b)
{
    sfemi_implicit *m = &b->implicit;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfemi_state *s = &b->state;
    sfem_int k;
    size_t i;
    int c;
    for (k = 0; k < b->pin_count; ++k) {
        const size_t at = 3 * (size_t)b->pin[k];
        sfem_real x[3], v[3], a[3];
        for (c = 0; c < 3; ++c) x[c] = b->model->mesh.x[at + (size_t)c] + s->u[at + (size_t)c];
        sfemi_hold_motion(s->pin + k, x, b->step, s->head->h, v, a);
        for (c = 0; c < 3; ++c) {
            i = at + (size_t)c;
            if (!(b->mask[b->pin[k]] >> c & 1)) continue;
            s->u[i] = s->pin[k].target[c] - b->model->mesh.x[i];
            s->w[i] = v[c];
            s->a[i] = a[c];
        }
        sfemi_hold_advance(s->pin + k, x);
    }
    for (i = 0; i < n; ++i) {
        if (b->mask[i / 3] >> (i % 3) & 1) continue;
        s->u[i] += m->d[i];
        s->w[i] = m->mid_v[i];
        s->a[i] = m->mid_a[i];
    }
}

SFEM_DEF sfem_newton_info sfem_body_newton(const sfem_body *b)
{
    SFEM_ASSERT(b);
    return b->implicit.info;
}

/* ---- statics ---- */

/* f(u) = F, the held axes of mask at known, and the handles in grip.slot at their targets, from the present u
 * on; the solution to u. Steps of the load, in which the force that is out of balance at the start
 * vanishes in proportion and pins and handles go their ways. */
static sfem_status sfemi_implicit_equilibrium(sfem_body *b, sfemi_system *system, const sfem_real *known,
                                              sfem_real *u, sfem_error *err)
{
    sfemi_implicit *m = &b->implicit;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const unsigned char *mask = system->factor->mask;
    sfem_real reached = 0, part = 1.0 / b->def.newton.load_steps;
    sfemi_newton t;
    sfem_status status = SFEM_OK;
    size_t i;
    memset(&m->info, 0, sizeof m->info);
    memset(&m->stage, 0, sizeof m->stage);
    m->stage.w1 = m->stage.end = 1;
    m->still = 1;
    memset(&t, 0, sizeof t);
    t.system = system;
    t.what = "the static solution";
    t.iterations = b->def.newton.iterations > 2 ? b->def.newton.iterations : 20;
    sfemi_implicit_load(b, 0, m->amap);                            /* F */
    sfemi_implicit_terms(b, b->state.u, NULL, NULL, m->vmap, m->q); /* f at the start */
    memset(m->mid_d, 0, n * sizeof *m->mid_d);                     /* where it converged last */
    while (reached < 1) {
        if (part > 1 - reached - 1e-9) part = 1 - reached;
        m->share = part == 1 - reached ? 1 : reached + part;
        memcpy(m->d, m->mid_d, n * sizeof *m->d);
        for (i = 0; i < n; ++i) {
            const int held = mask[i / 3] >> (i % 3) & 1;
            m->load[i] = m->vmap[i] + m->share * (m->amap[i] - m->vmap[i]);
            m->goal[i] = held ? m->share * (known[i] - b->state.u[i]) : 0;
        }
        status = sfemi_newton_run(b, &t, err);
        ++m->info.load_steps;
        if (status == SFEM_OK) {
            memcpy(m->mid_d, m->d, n * sizeof *m->d);
            reached = m->share;
            part = fmin(2 * part, 1.0 / b->def.newton.load_steps);
        } else if (part < 2.0 / 1024 || status == SFEM_OUT_OF_MEMORY) {
            break;
        } else {
            part /= 2;
        }
    }
    for (i = 0; i < n && status == SFEM_OK; ++i) u[i] = b->state.u[i] + m->mid_d[i];
    if (status == SFEM_NOT_CONVERGED)
        return sfemi_fail(err, status,
                          "the static solution did not converge: residual %.3g after %d iterations, at %.3g "
                          "of the load",
                          m->info.residual, (int)m->info.iterations, reached);
    return status;
}

/* ============================================================================================
 * >>pqr   the (p,q,r) family, central difference
 *         [Yuan et al. 2017, "A novel unconditionally stable explicit integration method ..."]
 *
 *   A a = F - f(u) - D w,  w' = w + h a,  u' = u + h w',   A = r M + (q/2) h D + p h^2 K
 *
 * with w the mean velocity over a step. (p,1,1) is Newmark(beta = p, gamma = 1/2) in another form, under
 * the load p F+ + (1-2p) F + p F-; p = 0 is central difference. The source starts with w = v0, which is
 * first order; here the first step is Newmark's own,
 *   A w1 = M v0 + (h/2)(F - f) + (1/4 - p) h^2 D a0 + p h (F+ - F),
 * and a step of another length, h1 before and h2 now, follows from the same two half-steps:
 *   A2 w' = (A1 - h1 D) w + ((h1+h2)/2)(F - f) + (1/4-p)(h2^2-h1^2) D a + p h2 (F+ - F) + p h1 (F- - F).
 * Both are put as one equation for a = (w' - w)/d, d = (h1 + h2)/2 being the time between the centres of the
 * two means and h1 = 0 the start: A a = b, where every force in b has weight one,
 *   b = F - f - D (cd w - ca a) + ck K w + p (h2/d)(F+ - F) + p (h1/d)(F- - F),
 *   ck = 2 p (h1 - h2),  cd = (h1 - (q/2)(h1 - h2))/d,  ca = 2 (1/4 - p)(h2 - h1).
 * Because positions follow from the mean velocity, a constraint on u' sets w' and leaves nothing to ring.
 * ============================================================================================ */

typedef struct sfemi_pqr_terms {
    sfem_real d;       /* s, see above */
    sfem_real ck, cd, ca;
    sfem_real load[3]; /* of F+, F, F-; their sum is 1 */
} sfemi_pqr_terms;

static int sfemi_pqr_starts_at_fourth_order(const sfem_body *b)
{
    return b->def.start == SFEM_START_FOURTH_ORDER && fabs(b->p - 1.0 / 12) < 1e-9 && b->alpha == 0 &&
           b->beta == 0 && !b->model->damping;
}

static sfemi_pqr_terms sfemi_pqr_weigh(const sfem_body *b, sfem_real h2)
{
    const sfemi_coefficients k = sfemi_body_coefficients(b, b->p);
    const int running = b->state.head->started == SFEMI_RUNNING;
    const sfem_real h1 = running ? b->state.head->h : 0;
    sfemi_pqr_terms t;
    t.d = (h1 + h2) / 2;
    t.ck = 2 * k.p * (h1 - h2);
    t.cd = running ? (h1 - k.q / 2 * (h1 - h2)) / t.d : 1; /* 1: the mass that q adds has v0, too */
    t.ca = 2 * (0.25 - k.p) * (h2 - h1);
    t.load[0] = k.p * h2 / t.d;
    t.load[2] = k.p * h1 / t.d;
    if (!running && sfemi_pqr_starts_at_fourth_order(b)) {
        t.ck = -h2 / 3;
        t.load[0] = 1.0 / 3;
    }
    if (b->def.plain_load) t.load[0] = t.load[2] = 0;
    t.load[1] = 1 - t.load[0] - t.load[2];
    return t;
}

static void sfemi_pqr_predict(sfem_body *b, sfem_real h)
{
    const sfemi_state *s = &b->state;
    const sfemi_coefficients k = sfemi_body_coefficients(b, b->p);
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const int damped = b->alpha != 0 || b->beta != 0 || b->zd != NULL;
    int with_mass = b->alpha != 0, c;
    sfemi_pqr_terms t;
    sfem_int j;
    size_t i;
    if (s->head->started != SFEMI_RUNNING && damped && b->p != 0.25)
        sfemi_body_initial_acceleration(b, k.r);
    t = sfemi_pqr_weigh(b, h);
    for (i = 0; i < n; ++i) {
        const sfem_real dv = damped ? t.cd * s->w[i] - t.ca * s->a[i] : 0;
        b->zk[i] = s->u[i] - t.ck * s->w[i] + b->beta * dv;
        b->zm[i] = b->alpha * dv;
        if (b->zd) b->zd[i] = dv;
        b->acc[i] = 0;
    }
    for (j = 0; j < b->pin_count; ++j) { /* held axes have a given a: their columns of A go to the right */
        for (c = 0; c < 3; ++c) {
            sfem_real a;
            i = 3 * (size_t)b->pin[j] + (size_t)c;
            if (!(b->mask[b->pin[j]] >> c & 1)) continue;
            a = ((s->pin[j].target[c] - b->model->mesh.x[i] - s->u[i]) / h - s->w[i]) / t.d;
            b->acc[i] = a;
            b->zk[i] += (k.p * h + k.q / 2 * b->beta) * h * a;
            b->zm[i] += (k.r + k.q / 2 * h * b->alpha) * a;
            if (b->zd) b->zd[i] += k.q / 2 * h * a;
            with_mass |= b->model->block_mass != NULL && a != 0;
        }
    }
    sfemi_body_residual(b, t.load, with_mass);
}

static void sfemi_pqr_solve(sfem_body *b)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real h = b->step;
    size_t i;
    if (!b->grip.count) return;
    for (i = 0; i < n; ++i) b->zk[i] = b->state.u[i] + h * b->state.w[i];
    sfemi_body_handle_gap(b, &b->grip, b->zk, h * sfemi_pqr_weigh(b, h).d);
    sfemi_grip_apply(&b->grip, b->state.handle, b->model->mesh.nodes, b->acc);
}

static void sfemi_pqr_finish(sfem_body *b)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real h = b->step, d = sfemi_pqr_weigh(b, h).d;
    sfemi_state *s = &b->state;
    sfem_int k;
    size_t i;
    int c;
    for (k = 0; k < b->pin_count; ++k) {
        sfem_real x[3];
        for (c = 0; c < 3; ++c) {
            i = 3 * (size_t)b->pin[k] + (size_t)c;
            x[c] = b->model->mesh.x[i] + s->u[i];
        }
        sfemi_hold_advance(s->pin + k, x);
    }
    for (i = 0; i < n; ++i) {
        s->w[i] += d * b->acc[i];
        s->u[i] += h * s->w[i];
        s->a[i] = b->acc[i];
    }
}

/* Largest eigenvalue of the symmetric tridiagonal matrix (d [k], e [k-1]) by bisection on Sturm counts. */
static sfem_real sfemi_pqr_tridiagonal_max(const sfem_real *d, const sfem_real *e, int k)
{
    sfem_real low = d[0], high = d[0];
    int i, step;
    for (i = 0; i < k; ++i) {
        const sfem_real radius = (i ? fabs(e[i - 1]) : 0) + (i + 1 < k ? fabs(e[i]) : 0);
        if (d[i] > low) low = d[i];
        if (d[i] + radius > high) high = d[i] + radius;
    }
    for (step = 0; step < 60 && high - low > 1e-14 * high; ++step) {
        const sfem_real mid = 0.5 * (low + high);
        sfem_real q = d[0] - mid;
        int below = q < 0; /* eigenvalues below mid */
        for (i = 1; i < k; ++i) {
            if (q == 0) q = 1e-300;
            q = d[i] - mid - e[i - 1] * e[i - 1] / q;
            below += q < 0;
        }
        if (below == k) high = mid;
        else low = mid;
    }
    return high;
}

/* |last component| of the normalised eigenvector of theta: what the residual of its Ritz vector is
 * proportional to. */
static sfem_real sfemi_pqr_tridiagonal_last(const sfem_real *d, const sfem_real *e, int k, sfem_real theta)
{
    sfem_real before = 0, now = 1, sum = 1, next;
    int i;
    for (i = 0; i + 1 < k; ++i) {
        next = ((theta - d[i]) * now - (i ? e[i - 1] * before : 0)) / e[i];
        before = now;
        now = next;
        sum += now * now;
        if (sum > 1e200) {
            before *= 1e-100;
            now *= 1e-100;
            sum *= 1e-200;
        }
    }
    return fabs(now) / sqrt(sum);
}

/* A bound that needs no iteration: the largest omega^2 of any single tet, by the Frobenius norm of K_e. On
 * vectors without a rigid part M_e is rho V/20 when consistent, rho V/4 when lumped. */
static sfem_real sfemi_pqr_element_bound(const sfem_body *b)
{
    const sfem_model *model = b->model;
    sfem_real most = 0;
    sfem_int e;
    int i, j, k;
    for (e = 0; e < model->mesh.tets; ++e) {
        sfem_real g[4][3], block[9], sum = 0, mass;
        const sfem_real v = sfemi_element_gradients(&model->mesh, e, g);
        for (i = 0; i < 4; ++i)
            for (j = 0; j < 4; ++j) {
                sfemi_element_block(g[i], g[j], v * model->lambda[e], v * model->mu[e], block);
                for (k = 0; k < 9; ++k) sum += block[k] * block[k];
            }
        mass = model->density[e] * v / (model->block_mass ? 20 : 4);
        if (sqrt(sum) / mass > most) most = sqrt(sum) / mass;
    }
    return most;
}

/* An upper estimate of the largest omega: Lanczos on M^-1 K with a lumped M [Lanczos 1950], the Ritz value
 * plus its residual, never above the bound by elements. A consistent M is at least a fifth of its
 * lumped form, tet by tet, so its omega^2 is at most five times the lumped one. */
static sfem_status sfemi_pqr_find_omega(sfem_body *b, sfem_error *err)
{
    enum { STEPS = 80 };
    const sfem_model *model = b->model;
    const size_t n = 3 * (size_t)model->mesh.nodes;
    const sfem_real bound = sfemi_pqr_element_bound(b);
    sfem_real d[STEPS], e[STEPS], *v = NULL, *before, *kv, norm = 0, top = 0;
    uint64_t seed = 88172645463325252u;
    sfem_status status = SFEM_OK;
    size_t i;
    int k;
    SFEMI_NEW(sfem_real, v, &b->allocator, 3 * n);
    before = v + n;
    kv = v + 2 * n;
    for (i = 0; i < n; ++i) { /* xorshift [Marsaglia 2003] */
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        v[i] = b->mask[i / 3] >> (i % 3) & 1 ? 0 : (sfem_real)(seed >> 11) / 9007199254740992.0 - 0.5;
        norm += v[i] * v[i] * model->node_mass[i / 3];
    }
    for (k = 0; k < STEPS && norm > 0; ++k) {
        sfem_real dot = 0, root = sqrt(norm), theta;
        for (i = 0; i < n; ++i) {
            v[i] /= root;
            before[i] *= k ? root : 0;
        }
        sfem_model_multiply_stiffness(model, v, kv, &b->exec);
        for (i = 0; i < n; ++i) dot += v[i] * kv[i];
        d[k] = dot;
        norm = 0;
        for (i = 0; i < n; ++i) {
            const int held = b->mask[i / 3] >> (i % 3) & 1;
            const sfem_real next = held ? 0 : kv[i] / model->node_mass[i / 3] - dot * v[i] - before[i];
            before[i] = v[i];
            v[i] = next;
            norm += next * next * model->node_mass[i / 3];
        }
        e[k] = sqrt(norm);
        theta = sfemi_pqr_tridiagonal_max(d, e, k + 1);
        top = theta + e[k] * sfemi_pqr_tridiagonal_last(d, e, k + 1, theta);
        if (top - theta < 1e-4 * theta) break;
    }
    if (model->block_mass) top *= 5;
    b->omega_max = sqrt(top < bound ? top : bound);
done:
    sfemi_delete(&b->allocator, v);
    return status;
}

/* The smallest h > 0 at which a h^2 + 2 half h + c, c > 0, turns negative; 0 if none. */
static sfem_real sfemi_pqr_smallest_root(sfem_real a, sfem_real half, sfem_real c)
{
    const sfem_real root = half * half - a * c;
    if (root < 0 || (half >= 0 && a >= 0)) return 0;
    return c / (sqrt(root) - half); /* without cancellation */
}

/* The largest stable h, 0 for no limit: 4 r + 2 (q-1) h (alpha + beta w^2) + (4p-1) h^2 w^2 >= 0 at the
 * largest omega w, from 4 A >= h^2 K + 2 h D. For Newmark 1/sqrt(gamma/2 - beta) [Hughes 1987]. */
static sfem_real sfemi_pqr_stable_step(const sfem_body *b, sfem_real p)
{
    const sfemi_coefficients k = sfemi_body_coefficients(b, p);
    const sfem_real w2 = b->omega_max * b->omega_max;
    if (b->def.integrator == SFEM_NEWMARK) {
        const sfem_real gap = b->def.gamma / 2 - b->def.beta;
        return gap <= 0 ? 0 : 1 / sqrt(gap * w2);
    }
    return sfemi_pqr_smallest_root((4 * k.p - 1) * w2, (k.q - 1) * (b->alpha + b->beta * w2), 4 * k.r);
}

/* Does a step of any length need omega_max? */
static int sfemi_pqr_needs_omega(const sfem_body *b)
{
    if (b->def.integrator == SFEM_NEWMARK) return b->def.beta < b->def.gamma / 2;
    if (b->def.integrator > SFEM_CENTRAL) return 0;
    if (b->def.integrator == SFEM_CENTRAL) return 1;
    if (b->def.p == SFEM_P_SAFE || (b->def.p == SFEM_P_AUTO && b->model->turns)) return b->def.q < 1;
    return b->def.p < 0.25 || b->def.q < 1; /* SFEM_P_AUTO is below 1/4 too */
}

/* ============================================================================================
 * >>turn   the inverse of A in a body that turns: frames, rigid projection
 *
 * The factor is of the rest pose, A0. For a body that turns, A = Q A0 Q^T with one rotation a node,
 * Q_i = polar(sum V_e R_e) over its tets, or one a piece; a lumped M commutes with Q. That does not keep
 * rigid motions free of force, so on pieces that nothing holds
 *   A^-1 b = N (N^T c M N)^-1 N^T b + P Q A0^-1 Q^T P^T b,   P = I - N (N^T M N)^-1 N^T M,
 * N being the six rigid motions at the present positions, cm M the mass part of A0: linear and angular
 * momentum are then exact, and the form is symmetric. Stiffness damping turns alike, D w = alpha M w +
 * P^T Q (beta K + rest) Q^T P w, which A bounds. A piece that a handle holds counts as held.
 * ============================================================================================ */

/* Inverse of an inertia, kept finite where it is singular; that of a piece crushed to a point, so far below
 * its inertia at rest that only rounding tells its rotation, becomes zero. */
static void sfemi_turn_invert(const sfem_real m[9], sfem_real rest, sfem_real inverse[9])
{
    sfem_real a[9], c[9], det;
    int i;
    memcpy(a, m, sizeof a);
    for (i = 0; i < 9; i += 4) a[i] += 1e-12 * (m[0] + m[4] + m[8]);
    sfemi_cofactor3(a, c);
    det = (a[0] * c[0] + a[1] * c[1] + a[2] * c[2]);
    for (i = 0; i < 9; ++i) inverse[i] = det > 0 && m[0] + m[4] + m[8] > 1e-20 * rest ? c[i] / det : 0;
}

/* Mass, centre and inertia of every piece at X + u. */
static void sfemi_turn_locate(sfem_body *b, const sfem_real *u)
{
    const sfem_model *model = b->model;
    const sfem_int nodes = model->mesh.nodes;
    sfemi_turn *t = &b->turn;
    sfem_int i, k;
    int c;
    for (k = 0; k < t->pieces; ++k) {
        t->piece[k].mass = 0;
        memset(t->piece[k].centre, 0, sizeof t->piece[k].centre);
        memset(t->piece[k].inertia_inverse, 0, sizeof t->piece[k].inertia_inverse);
    }
    for (i = 0; i < nodes; ++i) {
        sfemi_piece *p = t->piece + t->piece_of[i];
        if (t->piece_of[i] < 0) continue;
        p->mass += model->node_mass[i];
        for (c = 0; c < 3; ++c)
            p->centre[c] += model->node_mass[i] *
                            (model->mesh.x[3 * (size_t)i + (size_t)c] + u[3 * (size_t)i + (size_t)c]);
    }
    for (k = 0; k < t->pieces; ++k)
        for (c = 0; c < 3; ++c) t->piece[k].centre[c] /= t->piece[k].mass;
    for (i = 0; i < nodes; ++i) {
        sfem_real r[3], m = model->node_mass[i], *in;
        if (t->piece_of[i] < 0 || t->piece[t->piece_of[i]].held) continue;
        in = t->piece[t->piece_of[i]].inertia_inverse;
        for (c = 0; c < 3; ++c)
            r[c] = model->mesh.x[3 * (size_t)i + (size_t)c] + u[3 * (size_t)i + (size_t)c] -
                   t->piece[t->piece_of[i]].centre[c];
        for (c = 0; c < 9; ++c)
            in[c] += m * ((c % 4 == 0 ? sfemi_dot3(r, r) : 0) - r[c / 3] * r[c % 3]);
    }
    for (k = 0; k < t->pieces; ++k)
        if (!t->piece[k].held) {
            sfem_real inertia[9];
            memcpy(inertia, t->piece[k].inertia_inverse, sizeof inertia);
            sfemi_turn_invert(inertia, t->piece[k].rest, t->piece[k].inertia_inverse);
        }
}

/* The pieces' sum m |X - centre|^2. */
static void sfemi_turn_weigh(sfem_body *b)
{
    const sfem_model *model = b->model;
    sfem_int i;
    int c;
    memset(b->guard.u, 0, 3 * (size_t)model->mesh.nodes * sizeof *b->guard.u);
    sfemi_turn_locate(b, b->guard.u);
    for (i = 0; i < model->mesh.nodes; ++i) {
        sfemi_piece *p = b->turn.piece + b->turn.piece_of[i];
        for (c = 0; c < 3 && b->turn.piece_of[i] >= 0; ++c) {
            const sfem_real r = model->mesh.x[3 * (size_t)i + (size_t)c] - p->centre[c];
            p->rest += model->node_mass[i] * r * r;
        }
    }
}

/* Each free piece's momentum N^T x, x a force or momentum [nodes][3]; of M x where x is a velocity. */
static void sfemi_turn_momentum(sfem_body *b, const sfem_real *u, const sfem_real *x, int velocity)
{
    const sfem_model *model = b->model;
    sfemi_turn *t = &b->turn;
    sfem_int i, k;
    int c;
    for (k = 0; k < t->pieces; ++k) memset(t->piece[k].motion, 0, sizeof t->piece[k].motion);
    for (i = 0; i < model->mesh.nodes; ++i) {
        sfemi_piece *p = t->piece + t->piece_of[i];
        const size_t at = 3 * (size_t)i;
        sfem_real r[3], force[3], torque[3];
        if (t->piece_of[i] < 0 || p->held) continue;
        for (c = 0; c < 3; ++c) {
            r[c] = model->mesh.x[at + (size_t)c] + u[at + (size_t)c] - p->centre[c];
            force[c] = velocity ? model->node_mass[i] * x[at + (size_t)c] : x[at + (size_t)c];
        }
        sfemi_cross(r, force, torque);
        for (c = 0; c < 3; ++c) {
            p->motion[c] += force[c];
            p->motion[3 + c] += torque[c];
        }
    }
}

/* The motion that has this momentum: (N^T M N)^-1. */
static void sfemi_turn_divide(sfem_body *b)
{
    sfem_int k;
    int c;
    for (k = 0; k < b->turn.pieces; ++k) {
        sfemi_piece *p = b->turn.piece + k;
        sfem_real omega[3];
        if (p->held) continue;
        for (c = 0; c < 3; ++c) {
            p->motion[c] /= p->mass;
            omega[c] = sfemi_dot3(p->inertia_inverse + 3 * c, p->motion + 3);
        }
        memcpy(p->motion + 3, omega, sizeof omega);
    }
}

static void sfemi_turn_motion(sfem_body *b, const sfem_real *u, const sfem_real *x, int velocity)
{
    sfemi_turn_momentum(b, u, x, velocity);
    sfemi_turn_divide(b);
}

/* x += scale N motion on free pieces, times the nodes' masses where x is a force. */
static void sfemi_turn_add_motion(sfem_body *b, const sfem_real *u, sfem_real scale, int force,
                                  sfem_real *x)
{
    const sfem_model *model = b->model;
    sfem_int i;
    int c;
    for (i = 0; i < model->mesh.nodes; ++i) {
        const sfemi_piece *p = b->turn.piece + b->turn.piece_of[i];
        const size_t at = 3 * (size_t)i;
        sfem_real r[3], v[3], s;
        if (b->turn.piece_of[i] < 0 || p->held) continue;
        s = force ? scale * model->node_mass[i] : scale;
        for (c = 0; c < 3; ++c)
            r[c] = model->mesh.x[at + (size_t)c] + u[at + (size_t)c] - p->centre[c];
        sfemi_cross(p->motion + 3, r, v);
        for (c = 0; c < 3; ++c) x[at + (size_t)c] += s * (p->motion[c] + v[c]);
    }
}

/* y = Q^T x or Q x, node by node; y may be x. */
static void sfemi_turn_rotate(const sfem_real *frame, sfem_int nodes, int back, const sfem_real *x,
                              sfem_real *y)
{
    sfem_int i;
    for (i = 0; i < nodes; ++i, x += 3, y += 3, frame += 9) {
        const sfem_real a = x[0], b = x[1], c = x[2];
        if (back) {
            y[0] = frame[0] * a + frame[3] * b + frame[6] * c;
            y[1] = frame[1] * a + frame[4] * b + frame[7] * c;
            y[2] = frame[2] * a + frame[5] * b + frame[8] * c;
        } else {
            y[0] = frame[0] * a + frame[1] * b + frame[2] * c;
            y[1] = frame[3] * a + frame[4] * b + frame[5] * c;
            y[2] = frame[6] * a + frame[7] * b + frame[8] * c;
        }
    }
}

static int sfemi_turn_projects(const sfem_body *b)
{
    sfem_int k;
    for (k = 0; b->def.frame != SFEM_FRAME_REST && k < b->turn.pieces; ++k)
        if (!b->turn.piece[k].held) return 1;
    return 0;
}

/* x = A^-1 x, see above, held axes becoming 0; with u NULL without the projection. */
static void sfemi_turn_solve(sfem_body *b, const sfem_factor *f, const sfem_real *u,
                             const sfem_real *frame, sfem_real *x)
{
    const sfem_int nodes = b->model->mesh.nodes;
    const int projects = u && sfemi_turn_projects(b);
    sfem_int i, k;
    int c;
    if (projects) {
        sfemi_turn_motion(b, u, x, 0);
        sfemi_turn_add_motion(b, u, -1, 1, x);
    }
    for (i = 0; i < nodes; ++i)
        for (c = 0; c < 3; ++c)
            if (b->mask[i] >> c & 1) x[3 * (size_t)i + (size_t)c] = 0;
    sfemi_turn_rotate(frame, nodes, 1, x, x);
    sfemi_factor_solve(f, nodes, 1, x, x, b->work, &b->exec);
    sfemi_turn_rotate(frame, nodes, 0, x, x);
    if (!projects) return;
    for (k = 0; k < b->turn.pieces; ++k) /* the motion of the first part, while the second is removed */
        memcpy(b->turn.piece[k].kept, b->turn.piece[k].motion, sizeof b->turn.piece[k].kept);
    sfemi_turn_motion(b, u, x, 1);
    for (k = 0; k < b->turn.pieces; ++k)
        for (c = 0; c < 6; ++c)
            b->turn.piece[k].motion[c] = b->turn.piece[k].kept[c] / f->key.cm - b->turn.piece[k].motion[c];
    sfemi_turn_add_motion(b, u, 1, 0, x);
}

/* y = P^T Q (K Q^T P z + rest of D Q^T P zd); zd may be NULL. z and zd are overwritten. */
static void sfemi_turn_stiffness(sfem_body *b, const sfem_real *u, const sfem_real *frame, sfem_real *z,
                                 sfem_real *zd, sfem_real *y)
{
    const sfem_int nodes = b->model->mesh.nodes;
    const int projects = sfemi_turn_projects(b);
    sfem_real *const both[2] = {z, zd};
    int k;
    for (k = 0; k < (zd ? 2 : 1); ++k) {
        if (projects) {
            sfemi_turn_motion(b, u, both[k], 1);
            sfemi_turn_add_motion(b, u, -1, 0, both[k]);
        }
        sfemi_turn_rotate(frame, nodes, 1, both[k], both[k]);
    }
    if (b->def.frame == SFEM_FRAME_MAJORANT) sfemi_factor_multiply_majorant(b->model, z, y);
    else sfem_matrix_multiply(&b->model->stiffness, z, y, &b->exec);
    if (zd) sfemi_fem_add_damping_rest(b->model, zd, y);
    sfemi_turn_rotate(frame, nodes, 0, y, y);
    if (!projects) return;
    sfemi_turn_motion(b, u, y, 0);
    sfemi_turn_add_motion(b, u, -1, 1, y);
}

/* Is the rotation of s = sum V_e R_e well determined: are its two smaller singular values, one of them
 * signed, together above a twentieth of V? They are at least trace S - V. */
static int sfemi_turn_polar(const sfem_real s[9], sfem_real volume, sfem_real r[9])
{
    sfem_real stretch[9], u[9], v[9], w[3], fresh[9];
    sfem_polar(s, fresh, stretch);
    if (!(stretch[0] + stretch[4] + stretch[8] > 1.05 * volume)) {
        sfem_signed_svd(s, u, w, v);
        if (!(w[1] + w[2] > 0.05 * volume)) return 0;
    }
    memcpy(r, fresh, sizeof fresh);
    return 1;
}

/* Q from the tets' rotations; where it is not determined, and at nodes that are held on some axes only,
 * it stays as it was. sum [nodes][9] is scratch. */
static void sfemi_turn_frames(sfem_body *b, const sfem_real *rotation, sfem_real *frame)
{
    const sfem_model *model = b->model;
    const int whole = b->def.frame == SFEM_FRAME_PIECE;
    sfem_real *sum = b->turn.sum, *volume = b->turn.sum + 9 * (size_t)model->mesh.nodes;
    sfem_int e, i;
    int a, c;
    if (b->def.frame == SFEM_FRAME_REST || b->def.frame == SFEM_FRAME_MAJORANT) return;
    memset(sum, 0, 10 * (size_t)model->mesh.nodes * sizeof *sum);
    for (e = 0; e < model->mesh.tets; ++e)
        for (a = 0; a < 4; ++a) {
            const sfem_int node = model->mesh.tet[4 * (size_t)e + (size_t)a];
            const size_t to = (size_t)(whole ? b->turn.piece_of[node] : node);
            for (c = 0; c < 9; ++c)
                sum[9 * to + (size_t)c] += model->volume[e] * rotation[9 * (size_t)e + (size_t)c];
            volume[to] += model->volume[e];
        }
    for (i = 0; whole && i < b->turn.pieces; ++i) /* -1 in place of a volume: leave all its frames */
        if (!sfemi_turn_polar(sum + 9 * (size_t)i, volume[i], sum + 9 * (size_t)i)) volume[i] = -1;
    for (i = 0; i < model->mesh.nodes; ++i) {
        if (b->turn.piece_of[i] < 0 || (b->mask[i] != 0 && b->mask[i] != SFEM_AXIS_ALL)) continue;
        if (!whole) sfemi_turn_polar(sum + 9 * (size_t)i, volume[i], frame + 9 * (size_t)i);
        else if (volume[b->turn.piece_of[i]] > 0)
            memcpy(frame + 9 * (size_t)i, sum + 9 * (size_t)b->turn.piece_of[i], 9 * sizeof *frame);
    }
}

/* Room for the solves with f, `rhs` at a time. */
static sfem_status sfemi_body_reserve_work(sfem_body *b, const sfem_factor *f, sfem_int rhs,
                                           sfem_error *err)
{
    const size_t size = sfemi_factor_work_size(f, rhs);
    sfem_real *work;
    sfem_status status = SFEM_OK;
    if (size <= b->work_size) return SFEM_OK;
    SFEMI_NEW(sfem_real, work, &b->allocator, size);
    sfemi_delete(&b->allocator, b->work);
    b->work = work;
    b->work_size = size;
done:
    return status;
}

/* Room for the columns of handle `slot`, where it is used or may not allocate later. */
static sfem_status sfemi_grip_reserve(sfem_body *b, sfemi_grip *g, sfem_int slot, sfem_error *err)
{
    const sfemi_handle *h = b->state.handle + slot;
    sfem_status status = SFEM_OK;
    sfem_int parts = b->def.no_allocation ? (b->turns ? 4 : 1) : 0, k, used = 0;
    sfem_real *y;
    for (k = 0; h->used && k < 4; ++k) used += h->weight[k] != 0;
    if (used > 0 && !b->turns) used = 1;
    if (used > parts) parts = used;
    if (parts <= g->parts[slot]) return SFEM_OK;
    SFEMI_NEW(sfem_real, y, &b->allocator, 9 * (size_t)parts * (size_t)b->model->mesh.nodes);
    sfemi_delete(&b->allocator, g->y[slot]);
    g->y[slot] = y;
    g->parts[slot] = parts;
    g->ready[slot] = 0;
done:
    return status;
}

/* ============================================================================================
 * >>guard   (p,q,r) for bodies that turn: the guarded step
 *
 * Turning the factor is not enough in violent motion. Two energies are watched, with L the loads and v_r,
 * L_r the parts of w' and L that do not move a free piece's centre of mass:
 *   Eb = 1/2 v_r.r M v_r + (Psi + Psi')/2 + (p - 1/2)(u'-u).(f'-f)/2 - L_r.(u + u')/2
 *   Ec = 1/2 v_r.r M v_r + Psi' - L_r.u'
 * Eb is conserved exactly where the body is linear and undamped, but blind to fast modes; Ec is not, and
 * is tested loosely. They may not pass a ledger B (the least energy so far, forgotten over half a
 * second, plus the work of handles, moved pins and changing loads) by more than .01 and .3 of a scale S,
 * the energy in motion over the last second. A step that does is taken back and done again as a
 * minimisation of
 *   Phi(z) = |z - y|_M^2/(2 h^2) + Psi(z),  y = u + h w + h^2 M^-1 L,
 * by descent with the factor of p = 1, from the better of u and y, until Ec is in order and a step gains
 * less than .01 S; Phi(z) <= Phi(u) alone implies Psi(z) - L.z <= Ec(u), so the last
 * resort, less velocity, always ends it. Then the motion starts afresh from there. Energy and momentum are
 * kept, angular momentum not wholly: a redone step of .7 rad loses up to a twentieth, less the finer h is.
 *   In a crumpled body neighbouring tets turn so differently that the turned factor is no guide: the steps
 * of descent get short, and the body would creep for minutes. Where one is shorter than 1/8, the isotropic
 * majorant of >>factor takes over, which bounds the corotational Phi so that length 1 lowers it, hastened
 * by the memory of the last steps (L-BFGS). Bodies crushed to a point, scattered or turned inside out are
 * back in shape after a few steps at nu = .3; at nu = .49 many scattered ones stay locked in a knot.
 * ============================================================================================ */

typedef struct sfemi_guard_energies {
    sfem_real kinetic, eb, ec, floor; /* floor: h^2/2 L_r.M^-1 L_r */
} sfemi_guard_energies;

/* Sums over a free piece, and the pieces' share in the energies of the whole. */
static sfemi_guard_energies sfemi_guard_measure(sfem_body *b, const sfem_real *u1, const sfem_real *w1,
                                                const sfem_real *f1, sfem_real psi1, sfem_real h)
{
    const sfem_model *model = b->model;
    const sfemi_state *s = &b->state;
    const sfem_real *g = s->head->gravity, r = sfemi_body_coefficients(b, b->p).r;
    sfemi_guard_energies e;
    sfem_real mid = 0, end = 0, stretch = 0;
    sfem_int i, k;
    int c;
    memset(&e, 0, sizeof e);
    for (k = 0; k < b->turn.pieces; ++k) memset(b->turn.piece[k].sum, 0, sizeof b->turn.piece[k].sum);
    for (i = 0; i < model->mesh.nodes; ++i) {
        const sfem_real m = model->node_mass[i];
        sfem_real(*sum)[3];
        if (b->turn.piece_of[i] < 0) continue;
        sum = b->turn.piece[b->turn.piece_of[i]].sum;
        for (c = 0; c < 3; ++c) {
            const size_t at = 3 * (size_t)i + (size_t)c;
            const sfem_real load = m * g[c] + s->force[1][at];
            if (b->mask[i] >> c & 1) continue;
            e.kinetic += m / 2 * w1[at] * w1[at];
            e.floor += h * h / 2 * load * load / m;
            mid -= load * (s->u[at] + u1[at]) / 2;
            end -= load * u1[at];
            stretch += (u1[at] - s->u[at]) * (f1[at] - s->f[at]);
            sum[0][c] += m * w1[at];
            sum[1][c] += load;
            sum[2][c] += m * (s->u[at] + u1[at]) / 2;
            sum[3][c] += m * u1[at];
        }
    }
    for (k = 0; k < b->turn.pieces; ++k) {
        const sfemi_piece *p = b->turn.piece + k;
        for (c = 0; !p->held && c < 3; ++c) {
            e.kinetic -= p->sum[0][c] * p->sum[0][c] / (2 * p->mass);
            e.floor -= h * h / 2 * p->sum[1][c] * p->sum[1][c] / p->mass;
            mid += p->sum[1][c] * p->sum[2][c] / p->mass;
            end += p->sum[1][c] * p->sum[3][c] / p->mass;
        }
    }
    e.kinetic *= r;
    e.eb = e.kinetic + (s->head->psi + psi1) / 2 + (b->p - 0.5) / 2 * stretch + mid;
    e.ec = e.kinetic + psi1 + end;
    return e;
}

static sfem_real sfemi_guard_forces(sfem_body *b, const sfem_real *u, sfem_real *f)
{
    return sfem_model_forces(b->model, u, b->def.precision, f, b->turn.rotation, NULL, b->turn.work, &b->exec);
}

/* Forces and frames where the state was set from outside; the pieces' places. */
static void sfemi_guard_look(sfem_body *b)
{
    sfemi_state_head *head = b->state.head;
    sfem_int i;
    if (!head->current) {
        for (i = 0; i < 9 * b->model->mesh.nodes; ++i) b->state.frame[i] = i % 9 % 4 ? 0 : 1;
        head->psi = sfemi_guard_forces(b, b->state.u, b->state.f);
        sfemi_turn_frames(b, b->turn.rotation, b->state.frame);
        head->current = 1;
        head->rebase = SFEMI_NEW_LEDGER;
    }
    sfemi_turn_locate(b, b->state.u);
}

/* A ledger for steps of h from here, where the present one is void. */
static void sfemi_guard_refresh(sfem_body *b, sfem_real h)
{
    sfemi_state_head *head = b->state.head;
    sfemi_guard_energies e;
    sfemi_guard_look(b);
    if (head->rebase == SFEMI_LEDGER) return;
    e = sfemi_guard_measure(b, b->state.u, b->state.w, b->state.f, head->psi, h);
    head->budget = head->last = e.ec;
    if (head->rebase == SFEMI_NEW_LEDGER) head->scale = 0;
    if (e.kinetic + head->psi > head->scale) head->scale = e.kinetic + head->psi;
    if (e.floor > head->scale) head->scale = e.floor;
    head->rebase = SFEMI_LEDGER;
}

static void sfemi_guard_predict(sfem_body *b, sfem_real h)
{
    const sfemi_state *s = &b->state;
    const sfemi_coefficients k = sfemi_body_coefficients(b, b->p);
    const sfem_model *model = b->model;
    const size_t n = 3 * (size_t)model->mesh.nodes;
    const int damped = b->alpha != 0 || b->beta != 0 || b->zd != NULL;
    int stiff, c;
    sfemi_pqr_terms t;
    sfem_int j;
    size_t i;
    b->step = h;
    sfemi_guard_refresh(b, h);
    t = sfemi_pqr_weigh(b, h);
    t.ca = 0; /* the source of growth where damping is stiff and the body turns; the order stays */
    stiff = b->beta != 0 || b->zd != NULL || t.ck != 0;
    for (i = 0; i < n; ++i) {
        const sfem_real dv = damped ? t.cd * s->w[i] : 0;
        b->zk[i] = b->beta * dv - t.ck * s->w[i];
        b->zm[i] = b->alpha * dv;
        if (b->zd) b->zd[i] = dv;
        b->acc[i] = 0;
    }
    for (j = 0; j < b->pin_count; ++j) {
        for (c = 0; c < 3; ++c) {
            i = 3 * (size_t)b->pin[j] + (size_t)c;
            if (!(b->mask[b->pin[j]] >> c & 1)) continue;
            b->acc[i] = ((s->pin[j].target[c] - model->mesh.x[i] - s->u[i]) / h - s->w[i]) / t.d;
            b->zk[i] += (k.p * h + k.q / 2 * b->beta) * h * b->acc[i];
            if (b->zd) b->zd[i] += k.q / 2 * h * b->acc[i];
            stiff |= b->acc[i] != 0;
        }
    }
    if (stiff) sfemi_turn_stiffness(b, s->u, s->frame, b->zk, b->zd, b->rhs);
    else memset(b->rhs, 0, n * sizeof *b->rhs);
    for (i = 0; i < n; ++i) b->rhs[i] += s->f[i] + model->node_mass[i / 3] * b->zm[i];
    if (b->def.corrections > 0) { /* what is to be added to the right side for the weights of Newmark(1/4) */
        const sfem_real after = h / (4 * t.d), before = t.d > h / 2 ? s->head->h / (4 * t.d) : 0;
        sfem_real weight[3];
        weight[0] = after - t.load[0];
        weight[1] = t.load[0] + t.load[2] - after - before;
        weight[2] = before - t.load[2];
        memset(b->guard.external, 0, n * sizeof *b->guard.external);
        if (!b->def.plain_load) sfemi_body_take_from_load(b, weight, b->guard.external, b->guard.external);
        for (i = 0; i < n; ++i) b->guard.external[i] += b->rhs[i];
    }
    sfemi_body_take_from_load(b, t.load, b->rhs, b->rhs);
}

/* In a turned body every node has a frame of its own, so a handle has three columns for each of its nodes,
 * in the rest pose; S = H Q Y0 Q^T H^T is put together anew each step. */
static void sfemi_guard_gather(sfem_body *b, sfemi_grip *g, const sfem_real *frame)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_int size = 3 * g->count;
    sfem_int i, j;
    int k, l, part, r, c, m;
    memset(g->s, 0, (size_t)size * (size_t)size * sizeof *g->s);
    for (i = 0; i < g->count; ++i) {
        const sfemi_handle *hi = b->state.handle + g->slot[i];
        for (j = 0; j <= i; ++j) {
            const sfemi_handle *hj = b->state.handle + g->slot[j];
            for (k = 0; k < 4; ++k)
                for (l = 0, part = 0; l < 4; ++l) {
                    const sfem_real *y, *qk, *ql;
                    sfem_real block[9], turned[9], both[9];
                    if (hj->weight[l] == 0) continue;
                    y = g->y[g->slot[j]] + 3 * n * (size_t)part++;
                    if (hi->weight[k] == 0) continue;
                    for (r = 0; r < 3; ++r)
                        for (c = 0; c < 3; ++c)
                            block[3 * r + c] = y[(size_t)c * n + 3 * (size_t)hi->node[k] + (size_t)r];
                    qk = frame + 9 * (size_t)hi->node[k];
                    ql = frame + 9 * (size_t)hj->node[l];
                    sfemi_mul3(qk, block, turned);
                    sfemi_mul3_nt(turned, ql, both);
                    for (m = 0; m < 9; ++m)
                        g->s[(3 * i + m / 3) * size + 3 * j + m % 3] += hi->weight[k] * hj->weight[l] * both[m];
                }
        }
    }
    sfemi_grip_factor(g->s, size, size);
}

/* l = S^-1 (c - H a), a += Q Y0 Q^T l, where g->lambda comes in as c. */
static void sfemi_guard_hold(sfem_body *b, sfemi_grip *g, const sfem_real *frame, sfem_real *a)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_real *y = b->turn.v;
    sfem_int i;
    size_t k;
    int c, l;
    if (!g->count) return;
    sfemi_guard_gather(b, g, frame);
    for (i = 0; i < g->count; ++i) {
        sfem_real mean[3];
        sfemi_grip_mean(b->state.handle + g->slot[i], a, mean);
        for (c = 0; c < 3; ++c) g->lambda[3 * i + c] -= mean[c];
    }
    sfemi_grip_solve(g->s, 3 * g->count, 3 * g->count, g->lambda, 1);
    memset(y, 0, n * sizeof *y);
    for (i = 0; i < g->count; ++i) {
        const sfemi_handle *h = b->state.handle + g->slot[i];
        const sfem_real *column = g->y[g->slot[i]];
        for (l = 0; l < 4; ++l) {
            const sfem_real *q = frame + 9 * (size_t)h->node[l], *lambda = g->lambda + 3 * i;
            if (h->weight[l] == 0) continue;
            for (c = 0; c < 3; ++c, column += n) {
                const sfem_real f = h->weight[l] * (q[c] * lambda[0] + q[3 + c] * lambda[1] + q[6 + c] * lambda[2]);
                for (k = 0; k < n; ++k) y[k] += f * column[k];
            }
        }
    }
    sfemi_turn_rotate(frame, b->model->mesh.nodes, 0, y, y);
    for (k = 0; k < n; ++k)
        if (!(b->mask[k / 3] >> (k % 3) & 1)) a[k] += y[k];
}

static void sfemi_guard_solve(sfem_body *b)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real h = b->step;
    sfem_real *x = b->zm;
    size_t i;
    memcpy(x, b->rhs, n * sizeof *x);
    for (i = 0; b->def.corrections > 0 && i < n; ++i) b->guard.external[i] += b->rhs[i]; /* L, user's included */
    sfemi_turn_solve(b, b->factor, b->state.u, b->state.frame, x);
    for (i = 0; i < n; ++i)
        if (!(b->mask[i / 3] >> (i % 3) & 1)) b->acc[i] = x[i];
    if (!b->grip.count) return;
    for (i = 0; i < n; ++i) b->zk[i] = b->state.u[i] + h * b->state.w[i];
    sfemi_body_handle_gap(b, &b->grip, b->zk, h * sfemi_pqr_weigh(b, h).d);
    sfemi_guard_hold(b, &b->grip, b->state.frame, b->acc);
}

/* Where the acceleration leads: w', u', f', Psi'. Returns Psi'. */
static sfem_real sfemi_guard_advance(sfem_body *b)
{
    sfemi_guard *g = &b->guard;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real d = sfemi_pqr_weigh(b, b->step).d;
    size_t i;
    for (i = 0; i < n; ++i) {
        g->w[i] = b->state.w[i] + d * b->acc[i];
        g->u[i] = b->state.u[i] + b->step * g->w[i];
    }
    return sfemi_guard_forces(b, g->u, g->f);
}

/* Takes from a correction of a what would move the handles; their forces follow. */
static void sfemi_guard_hold_correction(sfem_body *b, sfem_real *a)
{
    sfemi_grip *g = &b->grip;
    const size_t bytes = 3 * (size_t)g->count * sizeof *g->lambda;
    sfem_int k;
    if (!g->count) return;
    memcpy(g->place, g->lambda, bytes);
    memset(g->lambda, 0, bytes);
    sfemi_guard_hold(b, g, b->state.frame, a);
    for (k = 0; k < 3 * g->count; ++k) g->lambda[k] = g->place[k] - g->lambda[k];
}

/* Newton-like corrections with the same factor toward Newmark(1/4, 1/2) itself:
 *   r = M a + D (w + w')/2 + f'/4 + f/2 + f-/4 - L,  a -= A^-1 r,
 * at the start M a + D w' + f'/2 + f/2 - L. Returns Psi'. */
static sfem_real sfemi_guard_correct(sfem_body *b, sfem_real psi)
{
    sfemi_guard *g = &b->guard;
    const sfemi_state *s = &b->state;
    const sfem_model *model = b->model;
    const size_t n = 3 * (size_t)model->mesh.nodes;
    const int running = s->head->started == SFEMI_RUNNING;
    const int damped = b->alpha != 0 || b->beta != 0 || b->zd != NULL;
    const sfem_real h1 = running ? s->head->h : 0, d = (h1 + b->step) / 2, r0 = sfemi_body_coefficients(b, b->p).r;
    const sfem_real after = b->step / (4 * d), before = h1 / (4 * d);
    size_t i;
    int k;
    for (k = 0; k < b->def.corrections && sfemi_finite(psi); ++k) {
        sfem_real size = 0, change = 0;
        g->corrections = k + 1;
        for (i = 0; i < n; ++i) {
            const sfem_real v = running ? (s->w[i] + g->w[i]) / 2 : g->w[i];
            b->zk[i] = b->beta * v;
            if (b->zd) b->zd[i] = v;
            b->zm[i] = r0 * b->acc[i] + b->alpha * v;
        }
        if (damped && (b->beta != 0 || b->zd))
            sfemi_turn_stiffness(b, s->u, s->frame, b->zk, b->zd, g->grad);
        else memset(g->grad, 0, n * sizeof *g->grad);
        for (i = 0; i < n; ++i)
            g->grad[i] += model->node_mass[i / 3] * b->zm[i] + after * g->f[i] +
                          (1 - after - before) * s->f[i] + before * s->f_past[i] - g->external[i];
        sfemi_turn_solve(b, b->factor, s->u, s->frame, g->grad);
        sfemi_guard_hold_correction(b, g->grad);
        for (i = 0; i < n; ++i) {
            if (b->mask[i / 3] >> (i % 3) & 1) continue;
            change += model->node_mass[i / 3] * g->grad[i] * g->grad[i];
            size += model->node_mass[i / 3] * b->acc[i] * b->acc[i];
            b->acc[i] -= g->grad[i];
        }
        psi = sfemi_guard_advance(b);
        if (change <= b->def.correction_tolerance * b->def.correction_tolerance * size) break;
    }
    return psi;
}

/* Phi, its gradient on free axes in guard.grad, Psi and f at z. */
static sfem_real sfemi_guard_potential(sfem_body *b, const sfem_real *z, sfem_real *f, sfem_real *psi)
{
    sfemi_guard *g = &b->guard;
    const sfem_real *mass = b->model->node_mass, h = b->step;
    const sfem_real r = sfemi_body_coefficients(b, b->p).r;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_real phi = 0;
    size_t i;
    *psi = sfemi_guard_forces(b, z, f);
    for (i = 0; i < n; ++i) {
        const sfem_real inertia = r * mass[i / 3] * (z[i] - g->y[i]) / (h * h);
        const int held = b->mask[i / 3] >> (i % 3) & 1;
        if (!held) phi += inertia * (z[i] - g->y[i]) / 2;
        g->grad[i] = held ? 0 : inertia + f[i];
    }
    return phi + *psi;
}

/* Puts held axes at their targets and, by the redo's factor, the handles' points: z satisfies the
 * constraints, and what is added to it may not leave them. */
static void sfemi_guard_constrain(sfem_body *b, sfem_real *z)
{
    sfemi_grip *grip = &b->guard.redo[SFEMI_TURNED].grip;
    sfem_int k;
    int c;
    for (k = 0; k < b->pin_count; ++k)
        for (c = 0; c < 3; ++c) {
            const size_t at = 3 * (size_t)b->pin[k] + (size_t)c;
            if (b->mask[b->pin[k]] >> c & 1) z[at] = b->state.pin[k].target[c] - b->model->mesh.x[at];
        }
    if (!grip->count) return;
    for (k = 0; k < grip->count; ++k) { /* hold compares H z with the target's displacement */
        const sfemi_handle *h = b->state.handle + grip->slot[k];
        sfem_real rest[3];
        sfemi_grip_mean(h, b->model->mesh.x, rest);
        for (c = 0; c < 3; ++c) grip->lambda[3 * k + c] = h->hold.target[c] - rest[c];
    }
    sfemi_guard_hold(b, grip, b->state.frame, z);
}

static sfemi_guard_energies sfemi_guard_at(sfem_body *b, sfem_real psi)
{
    sfemi_guard *g = &b->guard;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    size_t i;
    for (i = 0; i < n; ++i) g->w[i] = (g->u[i] - b->state.u[i]) / b->step;
    return sfemi_guard_measure(b, g->u, g->w, g->f, psi, b->step);
}

/* The better of u and y, by Phi, as z in guard.u, with f and grad. Returns Phi. */
static sfem_real sfemi_guard_choose_start(sfem_body *b, sfem_real *psi)
{
    sfemi_guard *g = &b->guard;
    const size_t bytes = 3 * (size_t)b->model->mesh.nodes * sizeof(sfem_real);
    sfem_real phi, phi_y;
    memcpy(g->trial_u, g->y, bytes);
    sfemi_guard_constrain(b, g->trial_u);
    phi_y = sfemi_guard_potential(b, g->trial_u, g->f, psi);
    memcpy(g->u, b->state.u, bytes);
    sfemi_guard_constrain(b, g->u);
    phi = sfemi_guard_potential(b, g->u, g->f, psi);
    if (!(sfemi_finite(phi_y) && phi_y <= phi)) return phi;
    memcpy(g->u, g->trial_u, bytes);
    return sfemi_guard_potential(b, g->u, g->f, psi);
}

/* x = h^2 A^-1 x in the frames of z, leaving constraints alone. The isotropic majorant is taken as it is:
 * only then it bounds Phi. */
static void sfemi_guard_precondition(sfem_body *b, int kind, sfem_real *x)
{
    sfemi_grip *grip = &b->guard.redo[kind].grip;
    const sfem_real *frame = kind == SFEMI_TURNED ? b->guard.frame : b->guard.unit;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    size_t i;
    sfemi_turn_solve(b, b->guard.redo[kind].factor, kind == SFEMI_TURNED ? b->state.u : NULL, frame, x);
    if (grip->count) {
        memset(grip->lambda, 0, 3 * (size_t)grip->count * sizeof *grip->lambda);
        sfemi_guard_hold(b, grip, frame, x);
    }
    for (i = 0; i < n; ++i) x[i] *= b->step * b->step;
}

static sfem_real sfemi_guard_dot(const sfem_real *a, const sfem_real *b, size_t n)
{
    sfem_real sum = 0;
    size_t i;
    for (i = 0; i < n; ++i) sum += a[i] * b[i];
    return sum;
}

/* dir, a direction of descent: minus the preconditioned gradient, with the majorant corrected by the pairs
 * (L-BFGS) [Nocedal 1980; with such a matrix: Liu, Bouaziz, Kavan 2017]. Returns grad.dir. */
static sfem_real sfemi_guard_direction(sfem_body *b, int kind)
{
    sfemi_guard *g = &b->guard;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const int count = kind == SFEMI_TURNED ? 0 : g->pairs < SFEMI_MEMORY ? g->pairs : SFEMI_MEMORY;
    sfem_real part[SFEMI_MEMORY], rho[SFEMI_MEMORY];
    size_t i;
    int k;
    if (kind == SFEMI_TURNED) sfemi_turn_frames(b, b->turn.rotation, g->frame);
    memcpy(g->dir, g->grad, n * sizeof *g->dir);
    for (k = 0; k < count; ++k) { /* from the last on */
        const sfem_real *s = g->pair + 2 * n * (size_t)((g->pairs - 1 - k) % SFEMI_MEMORY), *y = s + n;
        rho[k] = sfemi_guard_dot(s, y, n);
        part[k] = sfemi_guard_dot(s, g->dir, n) / rho[k];
        for (i = 0; i < n; ++i) g->dir[i] -= part[k] * y[i];
    }
    sfemi_guard_precondition(b, kind, g->dir);
    for (k = count - 1; k >= 0; --k) {
        const sfem_real *s = g->pair + 2 * n * (size_t)((g->pairs - 1 - k) % SFEMI_MEMORY), *y = s + n;
        const sfem_real back = sfemi_guard_dot(y, g->dir, n) / rho[k];
        for (i = 0; i < n; ++i) g->dir[i] += (part[k] - back) * s[i];
    }
    for (i = 0; i < n; ++i) g->dir[i] = -g->dir[i];
    return sfemi_guard_dot(g->grad, g->dir, n);
}

/* Puts the pair that was begun in its slot in order, if the gradient has changed along the step as it
 * must. */
static void sfemi_guard_remember(sfemi_guard *g, size_t n)
{
    sfem_real *s = g->pair + 2 * n * (size_t)(g->pairs % SFEMI_MEMORY), *y = s + n;
    size_t i;
    for (i = 0; i < n; ++i) {
        s[i] = g->u[i] - s[i];
        y[i] = g->grad[i] - y[i];
    }
    if (sfemi_guard_dot(s, y, n) > 1e-12 * sqrt(sfemi_guard_dot(s, s, n) * sfemi_guard_dot(y, y, n))) ++g->pairs;
}

/* One step of descent with Armijo's rule; 0 if there is none left to take. */
static int sfemi_guard_descend(sfem_body *b, int kind, sfem_real *phi, sfem_real *psi)
{
    sfemi_guard *g = &b->guard;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real slope = sfemi_guard_direction(b, kind);
    sfem_real length = 1;
    size_t i;
    int halvings;
    if (kind == SFEMI_ISOTROPIC) {
        sfem_real *s = g->pair + 2 * n * (size_t)(g->pairs % SFEMI_MEMORY);
        memcpy(s, g->u, n * sizeof *s);
        memcpy(s + n, g->grad, n * sizeof *s);
    }
    for (halvings = 0; halvings < (kind == SFEMI_TURNED ? 4 : 20) && slope < 0; ++halvings, length /= 2) {
        sfem_real value;
        for (i = 0; i < n; ++i) g->trial_u[i] = g->u[i] + length * g->dir[i];
        value = sfemi_guard_potential(b, g->trial_u, g->trial_f, psi);
        if (!(sfemi_finite(value) && value <= *phi + 1e-4 * length * slope)) continue;
        *phi = value;
        memcpy(g->u, g->trial_u, n * sizeof *g->u);
        memcpy(g->f, g->trial_f, n * sizeof *g->f);
        if (kind == SFEMI_ISOTROPIC) sfemi_guard_remember(g, n);
        return 1;
    }
    *phi = sfemi_guard_potential(b, g->u, g->f, psi); /* as it was, rotations and all */
    return 0;
}

/* Gives free pieces the momentum that h L adds to M w, and as much of the angular momentum as the ledger
 * allows. */
static void sfemi_guard_restore_momentum(sfem_body *b, sfem_real psi)
{
    sfemi_guard *g = &b->guard;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_real spin2 = 0, cross = 0, room, part = 1;
    sfemi_guard_energies e;
    size_t i;
    sfem_int k;
    int c;
    if (!sfemi_turn_projects(b)) return;
    for (i = 0; i < n; ++i)
        b->zk[i] = b->model->node_mass[i / 3] * (b->state.w[i] + (g->y[i] - b->state.u[i] - b->step * b->state.w[i]) / b->step);
    sfemi_turn_locate(b, b->state.u);
    sfemi_turn_momentum(b, b->state.u, b->zk, 0);
    for (k = 0; k < b->turn.pieces; ++k)
        memcpy(b->turn.piece[k].kept, b->turn.piece[k].motion, sizeof b->turn.piece[k].kept);
    sfemi_turn_locate(b, g->u);
    sfemi_turn_momentum(b, g->u, g->w, 1);
    for (k = 0; k < b->turn.pieces; ++k)
        for (c = 0; c < 6; ++c) b->turn.piece[k].motion[c] = b->turn.piece[k].kept[c] - b->turn.piece[k].motion[c];
    sfemi_turn_divide(b);
    for (k = 0; k < b->turn.pieces; ++k) { /* the centre's velocity costs no energy that is watched */
        memcpy(b->turn.piece[k].kept, b->turn.piece[k].motion, sizeof b->turn.piece[k].kept);
        memset(b->turn.piece[k].motion + 3, 0, 3 * sizeof(sfem_real));
    }
    sfemi_turn_add_motion(b, g->u, 1, 0, g->w);
    for (k = 0; k < b->turn.pieces; ++k) {
        memset(b->turn.piece[k].motion, 0, 3 * sizeof(sfem_real));
        memcpy(b->turn.piece[k].motion + 3, b->turn.piece[k].kept + 3, 3 * sizeof(sfem_real));
    }
    memset(b->zk, 0, n * sizeof *b->zk);
    sfemi_turn_add_motion(b, g->u, 1, 0, b->zk);
    for (i = 0; i < n; ++i) {
        spin2 += b->model->node_mass[i / 3] * b->zk[i] * b->zk[i] / 2;
        cross += b->model->node_mass[i / 3] * b->zk[i] * g->w[i];
    }
    e = sfemi_guard_measure(b, g->u, g->w, g->f, psi, b->step);
    room = b->state.head->budget - e.ec;
    if (spin2 + cross > room && spin2 > 0) {
        const sfem_real root = cross * cross + 4 * spin2 * (room > 0 ? room : 0);
        part = (sqrt(root) - cross) / (2 * spin2);
        part = part < 0 ? 0 : part > 1 ? 1 : part;
    }
    for (i = 0; i < n; ++i) g->w[i] += part * b->zk[i];
}

/* The last resort: scales what of w' is not rigid motion until Ec <= target, or to nothing. */
static void sfemi_guard_slow_down(sfem_body *b, sfem_real psi, sfem_real target)
{
    sfemi_guard *g = &b->guard;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfemi_guard_energies e = sfemi_guard_measure(b, g->u, g->w, g->f, psi, b->step);
    sfem_real inner = 0, scale;
    size_t i;
    if (e.ec <= target) return;
    memcpy(b->zk, g->w, n * sizeof *b->zk);
    sfemi_turn_locate(b, g->u);
    if (sfemi_turn_projects(b)) {
        sfemi_turn_motion(b, g->u, b->zk, 1);
        sfemi_turn_add_motion(b, g->u, -1, 0, b->zk);
    }
    for (i = 0; i < n; ++i)
        if (!(b->mask[i / 3] >> (i % 3) & 1)) inner += b->model->node_mass[i / 3] * b->zk[i] * b->zk[i] / 2;
        else b->zk[i] = 0;
    inner *= sfemi_body_coefficients(b, b->p).r;
    scale = inner > e.ec - target ? 1 - sqrt(1 - (e.ec - target) / inner) : 1;
    for (i = 0; i < n; ++i) g->w[i] -= scale * b->zk[i];
}

/* The work that handles and moved pins do in a step from u to z, by the forces `out of balance` there. */
static sfem_real sfemi_guard_work(sfem_body *b)
{
    const sfemi_guard *g = &b->guard;
    const sfem_real *mass = b->model->node_mass, h2 = b->step * b->step;
    const sfem_real r = sfemi_body_coefficients(b, b->p).r;
    sfem_real work = 0;
    sfem_int k;
    int l, c;
    for (k = 0; k < b->pin_count; ++k)
        for (c = 0; c < 3; ++c) {
            const size_t at = 3 * (size_t)b->pin[k] + (size_t)c;
            if (!(b->mask[b->pin[k]] >> c & 1)) continue;
            work += g->f[at] * (g->u[at] - b->state.u[at]); /* what is held has no energy that is watched */
        }
    for (k = 0; k < b->grip.count; ++k) {
        const sfemi_handle *h = b->state.handle + b->grip.slot[k];
        for (l = 0; l < 4; ++l)
            for (c = 0; h->weight[l] != 0 && c < 3; ++c) {
                const size_t at = 3 * (size_t)h->node[l] + (size_t)c;
                work += (r * mass[at / 3] * (g->u[at] - g->y[at]) / h2 + g->f[at]) * (g->u[at] - b->state.u[at]);
            }
    }
    return work;
}

/* The factor of the redo, and the handles' columns for it. */
static sfem_status sfemi_guard_prepare_redo(sfem_body *b, int kind, sfem_error *err)
{
    sfemi_redo *g = &b->guard.redo[kind];
    const sfem_real r = sfemi_body_coefficients(b, b->p).r, h = b->h;
    sfem_factor *f = NULL;
    sfemi_factor_key key;
    sfem_status status = SFEM_OK;
    sfem_int i;
    if (!g->factor || g->h != h) {
        key = b->factor->key;
        key.majorant = kind == SFEMI_ISOTROPIC;
        key.ck = kind == SFEMI_TURNED ? h * h + h * b->beta : h * h;
        key.cm = kind == SFEMI_TURNED ? r + h * b->alpha : r;
        key.cd = kind == SFEMI_TURNED && b->model->damping ? h : 0;
        SFEMI_TRY(sfemi_factor_get(b->model, &key, &b->exec, &f, &b->factors_made, err));
        sfemi_factor_release(b->model, g->factor);
        g->factor = f;
        g->h = h;
        for (i = 0; i < b->def.max_handles; ++i) g->grip.ready[i] = 0;
    }
    if (kind == SFEMI_ISOTROPIC && !b->guard.pair)
        SFEMI_NEW(sfem_real, b->guard.pair, &b->allocator, 6 * SFEMI_MEMORY * (size_t)b->model->mesh.nodes);
    SFEMI_TRY(sfemi_body_reserve_work(b, g->factor, b->grip.count || b->def.no_allocation ? 3 : 1, err));
    for (i = 0; i < b->def.max_handles; ++i) SFEMI_TRY(sfemi_grip_reserve(b, &g->grip, i, err));
    g->grip.count = b->grip.count;
    for (i = 0; i < b->grip.count; ++i) {
        const sfem_int slot = g->grip.slot[i] = b->grip.slot[i];
        if (!g->grip.ready[slot])
            sfemi_grip_columns(g->factor, b->state.handle + slot, b->model->mesh.nodes, 1, g->grip.y[slot],
                               b->work, &b->exec);
        g->grip.ready[slot] = 1;
    }
done:
    return status;
}

/* Lowers Phi, by the turned factor, or where that needs short steps, by the isotropic majorant, until Ec is
 * in order and a step of descent gains little. */
static sfem_status sfemi_guard_minimise(sfem_body *b, sfem_real phi, sfem_real target, sfem_real *psi,
                                        sfem_error *err)
{
    enum { LIMIT = 100 };
    sfemi_guard *g = &b->guard;
    const sfem_real scale = b->state.head->scale;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_real first = 0;
    sfem_status status = SFEM_OK;
    int k, kind = SFEMI_TURNED, poor = 0;
    g->pairs = 0;
    for (k = 0; k < LIMIT; ++k) {
        sfem_real norm = 0, before = phi;
        size_t i;
        for (i = 0; i < n; ++i) norm += g->grad[i] * g->grad[i];
        if (k == 0) first = norm;
        if (norm == 0 || norm < 1e-6 * first) break;
        if (sfemi_guard_descend(b, kind, &phi, psi)) {
            const int turned = kind == SFEMI_TURNED;
            ++b->state.head->descents;
            poor = before - phi <= (turned ? .01 : .001) * scale ? poor + 1 : 0;
            if (poor >= (turned ? 1 : 10) && sfemi_guard_at(b, *psi).ec <= target) break;
        } else if (kind == SFEMI_TURNED) {
            kind = SFEMI_ISOTROPIC;
            g->crumpled = 1;
            SFEMI_TRY(sfemi_guard_prepare_redo(b, kind, err));
        } else {
            break;
        }
    }
done:
    return status;
}

/* Does the step again, by minimisation. Leaves z, w', f, rotations and Psi in guard. */
static sfem_status sfemi_guard_redo(sfem_body *b, sfem_error *err)
{
    sfemi_guard *g = &b->guard;
    sfemi_state_head *head = b->state.head;
    const sfem_real *mass = b->model->node_mass, h = b->step, r = sfemi_body_coefficients(b, b->p).r;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_real psi, phi, target;
    sfem_status status;
    size_t i;
    g->crumpled = 0;
    status = sfemi_guard_prepare_redo(b, SFEMI_TURNED, err);
    if (status != SFEM_OK) return status;
    for (i = 0; i < n; ++i) {
        const sfem_real load = mass[i / 3] * head->gravity[i % 3] + b->state.force[1][i];
        g->y[i] = b->state.u[i] + h * b->state.w[i] + (mass[i / 3] > 0 ? h * h * load / (r * mass[i / 3]) : 0);
    }
    memcpy(g->frame, b->state.frame, 3 * n * sizeof *g->frame);
    sfemi_turn_locate(b, b->state.u);
    phi = sfemi_guard_choose_start(b, &psi);
    head->budget += sfemi_guard_work(b);
    target = head->budget + .01 * head->scale;
    if (head->last > target) target = head->last;
    status = sfemi_guard_minimise(b, phi, target, &psi, err);
    if (status != SFEM_OK) return status;
    if (b->grip.count) { /* what rounding has left of the handles' gaps after so many steps */
        sfemi_guard_constrain(b, g->u);
        (void)sfemi_guard_potential(b, g->u, g->f, &psi);
    }
    (void)sfemi_guard_at(b, psi);
    sfemi_guard_restore_momentum(b, psi);
    sfemi_guard_slow_down(b, psi, target);
    g->psi = psi;
    return SFEM_OK;
}

/* The ledger's share of a change of the loads while the body is where it is: energies count -L.(u + u-)/2,
 * or -L.u after a redo. */
static sfem_real sfemi_guard_load_change(const sfem_body *b)
{
    const sfemi_state *s = &b->state;
    const sfem_real back = s->head->started == SFEMI_RUNNING ? s->head->h / 2 : 0;
    sfem_real change = 0;
    sfem_int i, k;
    int c;
    for (k = 0; k < b->turn.pieces; ++k) memset(b->turn.piece[k].sum, 0, sizeof b->turn.piece[k].sum);
    for (i = 0; i < b->model->mesh.nodes; ++i) {
        sfemi_piece *p = b->turn.piece + b->turn.piece_of[i];
        if (b->turn.piece_of[i] < 0) continue;
        for (c = 0; c < 3; ++c) {
            const size_t at = 3 * (size_t)i + (size_t)c;
            const sfem_real u = s->u[at] - back * s->w[at], d = s->force[0][at] - s->force[1][at];
            change -= d * u;
            p->sum[0][c] += d;
            p->sum[1][c] += b->model->node_mass[i] * u;
        }
    }
    for (k = 0; k < b->turn.pieces; ++k)
        for (c = 0; !b->turn.piece[k].held && c < 3; ++c)
            change += b->turn.piece[k].sum[0][c] * b->turn.piece[k].sum[1][c] / b->turn.piece[k].mass;
    return change;
}

/* Work done in the step that is to be judged by handles, moved pins, and the part of the loads that is not
 * in the energies: force . (u' - u-)/2, half of that after a start. */
static sfem_real sfemi_guard_step_work(const sfem_body *b)
{
    const sfemi_state *s = &b->state;
    const sfemi_guard *g = &b->guard;
    const sfem_real h1 = s->head->started == SFEMI_RUNNING ? s->head->h : 0;
    const sfemi_pqr_terms t = sfemi_pqr_weigh(b, b->step);
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_real work = 0;
    sfem_int k;
    size_t i;
    int l, c;
    for (k = 0; k < b->grip.count; ++k) {
        const sfemi_handle *h = s->handle + b->grip.slot[k];
        for (l = 0; l < 4; ++l)
            for (c = 0; h->weight[l] != 0 && c < 3; ++c) {
                i = 3 * (size_t)h->node[l] + (size_t)c;
                work += b->grip.lambda[3 * k + c] * h->weight[l] * (g->u[i] - s->u[i] + h1 * s->w[i]) / 2;
            }
    }
    for (k = 0; k < b->pin_count; ++k)
        for (c = 0; c < 3; ++c) {
            i = 3 * (size_t)b->pin[k] + (size_t)c;
            if (!(b->mask[b->pin[k]] >> c & 1)) continue;
            work += s->f[i] * (g->u[i] - s->u[i] + h1 * s->w[i]) / 2;
        }
    if (s->head->loaded && s->head->load_age < 2)
        for (i = 0; i < n; ++i)
            work += (t.load[0] * (s->force[0][i] - s->force[1][i]) + t.load[2] * (s->force[2][i] - s->force[1][i])) *
                    (g->u[i] - s->u[i] + h1 * s->w[i]) / 2;
    return work;
}

/* The hand's force in a step that was done again: what is out of balance at the handle's nodes. */
static void sfemi_guard_handle_forces(sfem_body *b)
{
    const sfemi_guard *g = &b->guard;
    const sfem_real h2 = b->step * b->step / sfemi_body_coefficients(b, b->p).r;
    sfem_int k;
    int l, c;
    for (k = 0; k < b->grip.count; ++k) {
        sfemi_handle *h = b->state.handle + b->grip.slot[k];
        sfem_real sum = 0;
        memset(h->force, 0, sizeof h->force);
        for (l = 0; l < 4; ++l) {
            sum += h->weight[l] * h->weight[l];
            for (c = 0; h->weight[l] != 0 && c < 3; ++c) {
                const size_t at = 3 * (size_t)h->node[l] + (size_t)c;
                h->force[c] += h->weight[l] * (b->model->node_mass[h->node[l]] * (g->u[at] - g->y[at]) / h2 + g->f[at]);
            }
        }
        for (c = 0; c < 3; ++c) h->force[c] /= sum;
    }
}

/* Judges the step; where it fails, does it again. The state is not changed but for the ledger, which a
 * failure puts back. */
static sfem_status sfemi_guard_judge_step(sfem_body *b, sfem_error *err)
{
    sfemi_guard *g = &b->guard;
    sfemi_state_head *head = b->state.head;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real budget = head->budget;
    sfemi_guard_energies e;
    sfem_status status = SFEM_OK;
    g->corrections = 0;
    g->psi = sfemi_guard_advance(b);
    if (b->def.corrections > 0) g->psi = sfemi_guard_correct(b, g->psi);
    g->redone = 0;
    if (!b->def.no_guard && b->def.integrator == SFEM_PQR) {
        head->budget += sfemi_guard_step_work(b);
        e = sfemi_guard_measure(b, g->u, g->w, g->f, g->psi, b->step);
        g->redone = !(sfemi_finite(e.eb) && sfemi_finite(e.ec) && e.eb <= head->budget + .01 * head->scale &&
                    e.ec <= head->budget + .3 * head->scale);
    }
    if (g->redone) {
        head->budget = budget;
        status = sfemi_guard_redo(b, err);
        if (status != SFEM_OK) {
            head->budget = budget;
            return status;
        }
    }
    if (sfemi_finite(g->psi) && sfemi_all_finite(g->u, n) && sfemi_all_finite(g->w, n)) return SFEM_OK;
    head->budget = budget;
    return sfemi_fail(err, SFEM_NOT_FINITE, "the step leads to an energy that is not finite");
}

static void sfemi_guard_finish(sfem_body *b)
{
    sfemi_guard *g = &b->guard;
    sfemi_state *s = &b->state;
    sfemi_state_head *head = s->head;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real psi = g->psi;
    const int redone = g->redone;
    sfemi_guard_energies e;
    sfem_real energy, moving;
    sfem_int k;
    size_t i;
    int c;
    if (redone) sfemi_guard_handle_forces(b);
    else
        for (k = 0; k < b->grip.count; ++k)
            memcpy(s->handle[b->grip.slot[k]].force, b->grip.lambda + 3 * k, 3 * sizeof(sfem_real));
    sfemi_turn_locate(b, s->u); /* the pieces' masses serve the energies; the redo may have moved them */
    e = sfemi_guard_measure(b, g->u, g->w, g->f, psi, b->step);
    energy = head->energy = redone ? e.ec : e.eb;
    if (energy < head->budget) head->budget = energy + (head->budget - energy) * exp(-b->step / .5);
    moving = e.kinetic + (redone ? psi : (head->psi + psi) / 2);
    head->scale *= exp(-b->step);
    if (redone && g->crumpled) { /* most of the energy is gone: what may be made is counted anew */
        head->scale = 0;
        head->budget = energy;
    }
    if (moving > head->scale) head->scale = moving;
    if (e.floor > head->scale) head->scale = e.floor;
    head->last = e.ec;
    head->psi = psi;
    head->redone += redone;
    for (k = 0; k < b->pin_count; ++k) {
        sfem_real x[3];
        for (c = 0; c < 3; ++c)
            x[c] = b->model->mesh.x[3 * (size_t)b->pin[k] + (size_t)c] + s->u[3 * (size_t)b->pin[k] + (size_t)c];
        sfemi_hold_advance(s->pin + k, x);
    }
    for (i = 0; i < n; ++i) s->a[i] = redone ? 0 : b->acc[i];
    memcpy(s->f_past, s->f, n * sizeof *s->f);
    memcpy(s->f, g->f, n * sizeof *s->f);
    memcpy(s->u, g->u, n * sizeof *s->u);
    memcpy(s->w, g->w, n * sizeof *s->w);
    sfemi_turn_frames(b, b->turn.rotation, s->frame);
    head->started = redone ? SFEMI_RESTARTED : SFEMI_RUNNING;
}

/* ============================================================================================
 * >>body   the pipeline that a user calls: create, prepare, step, read
 * ============================================================================================ */

SFEM_DEF sfem_body_def sfem_default_body_def(void)
{
    sfem_body_def d;
    memset(&d, 0, sizeof d);
    d.integrator = SFEM_PQR;
    d.p = SFEM_P_SAFE;
    d.beta = 0.25;
    d.q = d.r = 1;
    d.correction_tolerance = 1e-3;
    d.gamma = 0.5;
    d.rho_inf = 0.8;
    d.hht_alpha = 0.1;
    d.newton.iterations = 20;
    d.newton.tolerance = 1e-8;
    d.newton.load_steps = 1;
    d.max_handles = 16;
    return d;
}

static sfem_status sfemi_body_check(const sfem_body_def *d, sfem_error *err)
{
    if ((unsigned)d->integrator > SFEM_BATHE)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "there is no integrator %d", (int)d->integrator);
    if (!(sfemi_finite(d->p) && (d->p >= 0 || d->p == SFEM_P_AUTO || d->p == SFEM_P_SAFE)))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "p is %g, must be >= 0, SFEM_P_SAFE or SFEM_P_AUTO", d->p);
    if ((unsigned)d->frame > SFEM_FRAME_MAJORANT)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "there is no frame %d", (int)d->frame);
    if (d->corrections < 0 || !(sfemi_finite(d->correction_tolerance) && d->correction_tolerance >= 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "corrections (%d, to %g) must be >= 0", (int)d->corrections,
                          d->correction_tolerance);
    if (!(sfemi_finite(d->q) && d->q >= 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "q is %g, must be >= 0", d->q);
    if (!(sfemi_finite(d->r) && d->r > 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "r is %g, must be > 0", d->r);
    if (!(sfemi_finite(d->beta) && d->beta > 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT,
                          "Newmark's beta is %g, must be > 0 (central difference is an integrator of its own)",
                          d->beta);
    if (!(sfemi_finite(d->gamma) && d->gamma >= 0.5))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT,
                          "Newmark's gamma is %g, must be >= 1/2 (below, it makes energy)", d->gamma);
    if (!(sfemi_finite(d->alpha) && d->alpha >= 0 && sfemi_finite(d->beta_k) && d->beta_k >= 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "Rayleigh damping (%g, %g) must be >= 0", d->alpha,
                          d->beta_k);
    if (!sfemi_all_finite(d->gravity, 3)) return sfemi_fail(err, SFEM_NOT_FINITE, "gravity is not finite");
    if (d->max_handles < 0 || d->max_handles > 1024)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "max_handles is %d, must be 0 to 1024",
                          (int)d->max_handles);
    return sfemi_implicit_check(d, err);
}

/* Is w the mean velocity over a step, not the velocity? */
static int sfemi_body_keeps_mean(const sfem_body *b)
{
    return b->def.integrator == SFEM_PQR || b->def.integrator == SFEM_CENTRAL;
}

/* Which body a state block belongs to: mesh size, pins, handle capacity, and what w means. */
static uint64_t sfemi_body_key(const sfem_body *b)
{
    const int64_t shape[5] = {b->model->mesh.nodes, b->model->mesh.tets, b->pin_count, b->def.max_handles,
                              !sfemi_body_keeps_mean(b)};
    const uint64_t hash = sfemi_state_hash(0xcbf29ce484222325u, shape, sizeof shape);
    return sfemi_state_hash(hash, b->mask, (size_t)b->model->mesh.nodes);
}

static void sfemi_body_reset_head(sfem_body *b, size_t bytes)
{
    sfemi_state_head *head = b->state.head;
    memcpy(head->magic, "sfemstat", 8);
    head->version = 1;
    head->size = bytes;
    head->key = sfemi_body_key(b);
}

/* Pins as a mask and a list without repetition. Nodes in no tet are masked and not listed. */
static sfem_status sfemi_body_collect_pins(const sfem_body *b, sfem_int count, const sfem_int *pins,
                                           const unsigned char *axes, unsigned char *mask, sfem_int *list,
                                           sfem_int *listed, sfem_error *err)
{
    const sfem_int nodes = b->model->mesh.nodes;
    sfem_int i;
    *listed = 0;
    if (count < 0 || (count > 0 && !pins))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "pin_count is %d without pins", (int)count);
    for (i = 0; i < nodes; ++i) mask[i] = 0;
    for (i = 0; i < count; ++i) {
        const int held = axes ? (int)axes[i] : (int)SFEM_AXIS_ALL;
        if (pins[i] < 0 || pins[i] >= nodes)
            return sfemi_fail(err, SFEM_BAD_ARGUMENT, "pin %d names node %d, the mesh has %d", (int)i,
                              (int)pins[i], (int)nodes);
        if (held < 1 || held > SFEM_AXIS_ALL)
            return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, pins[i], -1, "pin %d holds axes %d, must be 1 to 7",
                                 (int)i, held);
        if (!mask[pins[i]]) list[(*listed)++] = pins[i];
        mask[pins[i]] = (unsigned char)(mask[pins[i]] | held);
    }
    for (i = 0; i < nodes; ++i)
        if (b->model->node_mass[i] == 0) mask[i] = SFEM_AXIS_ALL;
    return SFEM_OK;
}

/* Each pin holds its node where it is. */
static void sfemi_body_place_pins(sfem_body *b)
{
    sfem_int k;
    int c;
    for (k = 0; k < b->pin_count; ++k) {
        sfemi_hold *hold = b->state.pin + k;
        for (c = 0; c < 3; ++c) {
            const size_t at = 3 * (size_t)b->pin[k] + (size_t)c;
            hold->target[c] = hold->past[c] = b->model->mesh.x[at] + b->state.u[at];
            if (b->mask[b->pin[k]] >> c & 1) b->state.w[at] = b->state.a[at] = 0;
        }
        hold->age = 0;
    }
}

static void sfemi_body_free_grip(sfem_body *b, sfemi_grip *g)
{
    const sfem_allocator *al = &b->allocator;
    sfem_int i;
    for (i = 0; g->y && i < b->def.max_handles; ++i) sfemi_delete(al, g->y[i]);
    sfemi_delete(al, g->y);
    sfemi_delete(al, g->slot);
    sfemi_delete(al, g->parts);
    sfemi_delete(al, g->ready);
    sfemi_delete(al, g->s);
    sfemi_delete(al, g->wm);
    sfemi_delete(al, g->lambda);
    sfemi_delete(al, g->place);
}

static sfem_status sfemi_body_allocate_grip(sfem_body *b, size_t k, sfemi_grip *g, sfem_error *err)
{
    const sfem_allocator *al = &b->allocator;
    sfem_status status = SFEM_OK;
    if (k == 0) return SFEM_OK;
    SFEMI_NEW(sfem_int, g->slot, al, k);
    SFEMI_NEW(sfem_real *, g->y, al, k);
    SFEMI_NEW(sfem_int, g->parts, al, k);
    SFEMI_NEW(sfem_int, g->ready, al, k);
    SFEMI_NEW(sfem_real, g->s, al, 9 * k * k);
    SFEMI_NEW(sfem_real, g->wm, al, 3 * k * k);
    SFEMI_NEW(sfem_real, g->lambda, al, 3 * k);
    SFEMI_NEW(sfem_real, g->place, al, 3 * k);
done:
    return status;
}

/* What only a body that turns needs. */
static sfem_status sfemi_body_allocate_turn(sfem_body *b, size_t handles, sfem_error *err)
{
    const sfem_allocator *al = &b->allocator;
    const size_t n = 3 * (size_t)b->model->mesh.nodes, tets = (size_t)b->model->mesh.tets;
    sfemi_guard *g = &b->guard;
    sfem_real **const vector[] = {&b->turn.v, &g->u, &g->w, &g->f, &g->external, &g->y, &g->grad, &g->dir,
                                  &g->trial_u, &g->trial_f};
    sfem_status status = SFEM_OK;
    size_t i;
    SFEMI_NEW(sfem_int, b->turn.piece_of, al, n / 3);
    SFEMI_TRY(sfem_mesh_components(&b->model->mesh, b->turn.piece_of, &b->turn.pieces, err));
    SFEMI_NEW(sfemi_piece, b->turn.piece, al, b->turn.pieces);
    SFEMI_NEW(sfem_real, b->turn.rotation, al,
              9 * tets + sfem_model_work_size(b->model) + n / 3 + (3 + 3 + 3 + sizeof vector / sizeof *vector) * n);
    b->turn.work = b->turn.rotation + 9 * tets;
    b->turn.sum = b->turn.work + sfem_model_work_size(b->model);
    g->frame = b->turn.sum + 3 * n + n / 3;
    g->unit = g->frame + 3 * n;
    for (i = 0; i < 3 * n; ++i) g->unit[i] = i % 9 % 4 ? 0 : 1;
    for (i = 0; i < sizeof vector / sizeof *vector; ++i) *vector[i] = g->unit + (3 + i) * n;
    for (i = 0; i < SFEMI_REDOS; ++i) SFEMI_TRY(sfemi_body_allocate_grip(b, handles, &g->redo[i].grip, err));
done:
    return status;
}

static void sfemi_body_destroy(sfem_body *b)
{
    const sfem_allocator al = b->allocator;
    int k;
    sfemi_implicit_destroy(b);
    sfemi_factor_release(b->model, b->factor);
    sfemi_factor_release(b->model, b->static_factor);
    sfemi_body_free_grip(b, &b->grip);
    for (k = 0; k < SFEMI_REDOS; ++k) {
        sfemi_factor_release(b->model, b->guard.redo[k].factor);
        sfemi_body_free_grip(b, &b->guard.redo[k].grip);
    }
    sfemi_delete(&al, b->guard.pair);
    sfemi_delete(&al, b->turn.piece_of);
    sfemi_delete(&al, b->turn.piece);
    sfemi_delete(&al, b->turn.rotation);
    sfemi_delete(&al, b->pin);
    sfemi_delete(&al, b->mask);
    sfemi_delete(&al, b->state.head);
    sfemi_delete(&al, b->rhs);
    sfemi_delete(&al, b->work);
    sfem_model_free(b->model);
    sfemi_delete(&al, b);
}

/* Which pieces are held by pins or handles. */
static void sfemi_body_find_held(sfem_body *b)
{
    sfem_int i, k;
    int l;
    for (k = 0; k < b->turn.pieces; ++k) b->turn.piece[k].held = 0;
    for (i = 0; i < b->pin_count; ++i)
        if (b->turn.piece_of[b->pin[i]] >= 0) b->turn.piece[b->turn.piece_of[b->pin[i]]].held = 1;
    for (i = 0; i < b->def.max_handles; ++i)
        for (l = 0; b->state.handle[i].used && l < 4; ++l)
            if (b->state.handle[i].weight[l] != 0)
                b->turn.piece[b->turn.piece_of[b->state.handle[i].node[l]]].held = 1;
}

static sfem_status sfemi_body_allocate(sfem_body *b, const sfem_body_def *def, sfem_error *err)
{
    const sfem_allocator *al = &b->allocator;
    const sfem_int nodes = b->model->mesh.nodes;
    const size_t n = 3 * (size_t)nodes, k = (size_t)def->max_handles;
    const size_t vectors = b->model->damping ? 5 : 4;
    sfem_status status = SFEM_OK;
    size_t bytes;
    void *block = NULL;
    SFEMI_NEW(unsigned char, b->mask, al, nodes);
    SFEMI_NEW(sfem_int, b->pin, al, def->pin_count > 0 ? def->pin_count : 1);
    SFEMI_TRY(sfemi_body_collect_pins(b, def->pin_count, def->pins, def->pin_axes, b->mask, b->pin,
                                      &b->pin_count, err));
    bytes = sfemi_state_bytes(nodes, b->turns, b->pin_count, def->max_handles);
    SFEMI_NEW(char, block, al, bytes);
    sfemi_state_lay_out(&b->state, block, nodes, b->turns, b->pin_count);
    sfemi_body_reset_head(b, bytes);
    memcpy(b->state.head->gravity, def->gravity, sizeof def->gravity);
    SFEMI_NEW(sfem_real, b->rhs, al, vectors * n);
    b->acc = b->rhs + n;
    b->zk = b->rhs + 2 * n;
    b->zm = b->rhs + 3 * n;
    b->zd = b->model->damping ? b->rhs + 4 * n : NULL;
    SFEMI_TRY(sfemi_body_allocate_grip(b, k, &b->grip, err));
    if (b->turns) SFEMI_TRY(sfemi_body_allocate_turn(b, k, err));
    if (sfemi_implicit_serves(b)) SFEMI_TRY(sfemi_implicit_reserve(b, err));
    if (b->turns) sfemi_turn_weigh(b);
    if (b->turns) sfemi_body_find_held(b);
done:
    return status;
}

SFEM_DEF sfem_status sfem_body_create(sfem_model *model, const sfem_body_def *def, sfem_body **out,
                                      sfem_error *err)
{
    sfem_body *b = NULL;
    sfem_status status;
    SFEM_ASSERT(model && def && out);
    SFEMI_TRY(sfemi_body_check(def, err));
    SFEMI_NEW(sfem_body, b, &def->allocator, 1);
    b->allocator = def->allocator;
    b->exec = def->exec;
    b->def = *def;
    b->def.pins = NULL;
    b->def.pin_axes = NULL;
    b->alpha = model->alpha + def->alpha;
    b->beta = model->beta + def->beta_k;
    b->model = model;
    b->turns = model->turns && (def->integrator == SFEM_PQR || def->integrator == SFEM_CENTRAL);
    sfemi_lock(&model->lock);
    ++model->references;
    sfemi_unlock(&model->lock);
    if (b->turns && model->block_mass) {
        status = sfemi_fail(err, SFEM_BAD_ARGUMENT,
                            "a nonlinear body steps with lumped mass only: a consistent one does not turn");
        goto done;
    }
    SFEMI_TRY(sfemi_body_allocate(b, def, err));
    sfemi_body_place_pins(b);
    *out = b;
    return SFEM_OK;
done:
    if (b) sfemi_body_destroy(b);
    return status;
}

SFEM_DEF void sfem_body_free(sfem_body *body)
{
    if (body) sfemi_body_destroy(body);
}

/* After a handle was taken or let go: where that frees or holds a piece, energies count anew. */
static void sfemi_body_held_changed(sfem_body *b)
{
    sfem_int k;
    int changed = 0;
    if (!b->turns) return;
    for (k = 0; k < b->turn.pieces; ++k) b->turn.piece[k].sum[0][0] = b->turn.piece[k].held;
    sfemi_body_find_held(b);
    for (k = 0; k < b->turn.pieces; ++k) changed |= (b->turn.piece[k].sum[0][0] > 0) != b->turn.piece[k].held;
    if (changed && b->state.head->rebase == SFEMI_LEDGER) b->state.head->rebase = SFEMI_REBASE;
}

/* Columns and dense blocks of the handles for the body's factor. */
static sfem_status sfemi_body_prepare_handles(sfem_body *b, sfem_error *err)
{
    sfemi_grip *g = &b->grip;
    sfem_status status = SFEM_OK;
    sfem_int i, count = 0;
    if (!g->dirty) return SFEM_OK;
    for (i = 0; i < b->def.max_handles; ++i) {
        SFEMI_TRY(sfemi_grip_reserve(b, g, i, err));
        count += b->state.handle[i].used;
    }
    if (count || b->def.no_allocation) SFEMI_TRY(sfemi_body_reserve_work(b, b->factor, 3, err));
    g->count = 0;
    for (i = 0; i < b->def.max_handles; ++i) {
        if (!b->state.handle[i].used) continue;
        if (!g->ready[i] && !b->implicit.system.matrix.val) /* else the columns change all the time */
            sfemi_grip_columns(b->factor, b->state.handle + i, b->model->mesh.nodes, b->turns, g->y[i],
                               b->work, &b->exec);
        g->ready[i] = 1;
        g->slot[g->count++] = i;
    }
    sfemi_grip_gather(g, b->state.handle, b->model, b->turns, b->mask);
    for (i = 0; b->turns && b->def.no_allocation && !b->def.no_guard && i < SFEMI_REDOS; ++i)
        SFEMI_TRY(sfemi_guard_prepare_redo(b, i, err));
    g->dirty = 0;
done:
    return status;
}

static void sfemi_body_forget_columns(sfem_body *b)
{
    sfem_int i;
    for (i = 0; i < b->def.max_handles; ++i) b->grip.ready[i] = 0;
    for (i = 0; b->turns && i < b->def.max_handles; ++i)
        b->guard.redo[SFEMI_TURNED].grip.ready[i] = b->guard.redo[SFEMI_ISOTROPIC].grip.ready[i] = 0;
    b->grip.dirty = 1;
}

/* Takes over a factor that the body owns a reference to. */
static void sfemi_body_adopt(sfem_body *b, sfem_factor *f)
{
    if (f == b->factor) {
        sfemi_factor_release(b->model, f); /* the body has one reference already */
        return;
    }
    sfemi_factor_release(b->model, b->factor);
    b->factor = f;
    sfemi_body_forget_columns(b);
}

static sfem_status sfemi_body_choose_p(sfem_body *b, sfem_real h, sfem_real *p, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfem_real limit;
    if (sfemi_pqr_needs_omega(b) && b->omega_max == 0) status = sfemi_pqr_find_omega(b, err);
    if (status != SFEM_OK) return status;
    if (b->def.integrator > SFEM_CENTRAL) {
        *p = 0;
        return SFEM_OK;
    }
    *p = b->def.integrator == SFEM_NEWMARK    ? b->def.beta
         : b->def.integrator == SFEM_CENTRAL ? 0
                                             : b->def.p;
    if (*p == SFEM_P_AUTO && !b->model->turns && b->omega_max * h < 2) *p = 1.0 / 12;
    if (*p < 0) *p = !b->model->turns ? 0.25 : b->model->hardens ? 0.5 : 0.27;
    limit = sfemi_pqr_stable_step(b, *p);
    if (limit > 0 && h > limit)
        return sfemi_fail(err, SFEM_UNSTABLE, "a step of %g s is beyond the stable one, %g s", h, limit);
    return SFEM_OK;
}

/* Newton's own factor serves any h. */
static int sfemi_body_has_factor(const sfem_body *b, sfem_real h)
{
    return b->factor && (h == b->h || (b->h > 0 && b->implicit.system.matrix.val));
}

static int sfemi_body_is_prepared(const sfem_body *b, sfem_real h)
{
    return sfemi_body_has_factor(b, h) && !b->grip.dirty;
}

static sfem_status sfemi_body_prepare_implicit(sfem_body *b, sfem_real h, sfem_real p, sfem_error *err)
{
    sfem_factor *f;
    sfem_status status = sfemi_implicit_get_factor(b, h, &f, err);
    if (status != SFEM_OK) return status;
    sfemi_body_adopt(b, f);
    b->h = 0; /* until all is there */
    status = sfemi_body_reserve_work(b, f, 3, err);
    if (status != SFEM_OK) return status;
    b->h = h;
    b->p = p;
    return sfemi_body_prepare_handles(b, err);
}

SFEM_DEF sfem_status sfem_body_prepare(sfem_body *b, sfem_real h, sfem_error *err)
{
    sfemi_coefficients k;
    sfemi_factor_key key;
    sfem_factor *f;
    sfem_real p;
    sfem_status status;
    SFEM_ASSERT(b);
    if (!(sfemi_finite(h) && h > 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "the time step is %g s, must be > 0", h);
    if (sfemi_body_is_prepared(b, h)) return SFEM_OK;
    b->phase = SFEMI_IDLE; /* a step under way would be solved with another matrix */
    if (!b->factor || h != b->h) {
        status = sfemi_body_choose_p(b, h, &p, err);
        if (status != SFEM_OK) return status;
        if (sfemi_implicit_serves(b)) return sfemi_body_prepare_implicit(b, h, p, err);
        k = sfemi_body_coefficients(b, p);
        key.ck = k.p * h * h + k.q / 2 * h * b->beta;
        key.cm = k.r + k.q / 2 * h * b->alpha;
        key.cd = b->model->damping ? k.q / 2 * h : 0;
        key.mask = b->mask;
        key.majorant = b->turns && b->def.frame == SFEM_FRAME_MAJORANT;
        key.precision = b->def.precision;
        key.ordering = b->def.ordering;
        status = sfemi_factor_get(b->model, &key, &b->exec, &f, &b->factors_made, err);
        if (status != SFEM_OK) return status;
        status = sfemi_body_reserve_work(b, f, 1, err);
        if (status != SFEM_OK) {
            sfemi_factor_release(b->model, f);
            return status;
        }
        sfemi_body_adopt(b, f);
        b->h = h;
        b->p = p;
    }
    return sfemi_body_prepare_handles(b, err);
}

SFEM_DEF sfem_status sfem_body_predict(sfem_body *b, sfem_real h, sfem_error *err)
{
    SFEM_ASSERT(b);
    if (!sfemi_body_is_prepared(b, h)) {
        sfem_status status;
        if (b->def.no_allocation && !sfemi_body_has_factor(b, h)) /* handles have had their room since */
            return sfemi_fail(err, SFEM_NOT_PREPARED, "the body is not prepared for a step of %g s", h);
        status = sfem_body_prepare(b, h, err);
        if (status != SFEM_OK) return status;
    }
    b->step = h;
    if (b->turns) sfemi_guard_predict(b, h);
    else if (sfemi_implicit_serves(b)) sfemi_implicit_predict(b);
    else if (b->def.integrator == SFEM_NEWMARK) sfemi_newmark_predict(b, h);
    else sfemi_pqr_predict(b, h);
    b->phase = SFEMI_PREDICTED;
    return SFEM_OK;
}

SFEM_DEF sfem_status sfem_body_solve(sfem_body *b, sfem_error *err)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    SFEM_ASSERT(b && b->phase == SFEMI_PREDICTED);
    if (sfemi_implicit_serves(b)) {
        const sfem_status status = sfemi_implicit_solve(b, err);
        b->phase = status == SFEM_OK ? SFEMI_SOLVED : SFEMI_IDLE;
        return status;
    }
    if (!b->turns)
        sfemi_factor_solve(b->factor, b->model->mesh.nodes, 1, b->rhs, b->acc, b->work, &b->exec);
    if (b->turns) sfemi_guard_solve(b);
    else if (b->def.integrator == SFEM_NEWMARK) sfemi_newmark_solve(b);
    else sfemi_pqr_solve(b);
    b->phase = SFEMI_IDLE;
    if (!sfemi_all_finite(b->acc, n))
        return sfemi_fail(err, SFEM_NOT_FINITE, "the step's acceleration is not finite: a force was not");
    b->phase = SFEMI_SOLVED;
    return SFEM_OK;
}

/* The load of the step that ends becomes that of the start of the next one. */
static void sfemi_body_age_load(sfem_body *b)
{
    const size_t bytes = 3 * (size_t)b->model->mesh.nodes * sizeof(sfem_real);
    if (!b->state.head->loaded || b->state.head->load_age >= 2) return;
    if (b->turns) b->state.head->budget += sfemi_guard_load_change(b);
    memcpy(b->state.force[2], b->state.force[1], bytes);
    memcpy(b->state.force[1], b->state.force[0], bytes);
    ++b->state.head->load_age;
}

/* The handles' forces, and what the integrator does at the end of a step of a linear body. */
static void sfemi_body_finish_linear(sfem_body *b)
{
    const sfemi_grip *g = &b->grip;
    sfem_int i;
    for (i = 0; i < g->count; ++i)
        memcpy(b->state.handle[g->slot[i]].force, g->lambda + 3 * i, 3 * sizeof *g->lambda);
    if (sfemi_implicit_serves(b)) sfemi_implicit_finish(b);
    else if (b->def.integrator == SFEM_NEWMARK) sfemi_newmark_finish(b);
    else sfemi_pqr_finish(b);
    if (!sfemi_body_keeps_mean(b)) sfemi_newmark_settle_handles(b, g->place);
    b->state.head->started = SFEMI_RUNNING;
}

SFEM_DEF sfem_status sfem_body_finish(sfem_body *b, sfem_error *err)
{
    sfemi_grip *g = &b->grip;
    sfem_int i;
    SFEM_ASSERT(b && b->phase == SFEMI_SOLVED);
    b->phase = SFEMI_IDLE;
    if (b->turns) {
        const sfem_status status = sfemi_guard_judge_step(b, err);
        if (status != SFEM_OK) return status;
    }
    for (i = 0; i < g->count; ++i) sfem_body_handle_position(b, g->slot[i], g->place + 3 * i);
    if (b->turns) sfemi_guard_finish(b);
    else sfemi_body_finish_linear(b);
    for (i = 0; i < g->count; ++i)
        sfemi_hold_advance(&b->state.handle[g->slot[i]].hold, g->place + 3 * i);
    b->state.head->time += b->step;
    b->state.head->h = b->step;
    ++b->state.head->steps;
    sfemi_body_age_load(b);
    return SFEM_OK;
}

SFEM_DEF sfem_status sfem_body_step(sfem_body *b, sfem_real h, sfem_error *err)
{
    sfem_status status = sfem_body_predict(b, h, err);
    if (status == SFEM_OK) status = sfem_body_solve(b, err);
    if (status == SFEM_OK) status = sfem_body_finish(b, err);
    return status;
}

SFEM_DEF sfem_real *sfem_body_rhs(sfem_body *b) { return b->rhs; }
SFEM_DEF sfem_real *sfem_body_acceleration(sfem_body *b) { return b->acc; }

/* ---- loads and state ---- */

SFEM_DEF void sfem_body_start(sfem_body *b)
{
    if (b->state.head->started == SFEMI_NOT_STARTED) b->state.head->started = SFEMI_LOAD_FIXED;
}

static void sfemi_body_load_changed(sfem_body *b)
{
    const size_t bytes = 3 * (size_t)b->model->mesh.nodes * sizeof(sfem_real);
    b->state.head->loaded = 1;
    b->state.head->load_age = 0;
    if (b->state.head->started != SFEMI_NOT_STARTED) return;
    memcpy(b->state.force[1], b->state.force[0], bytes);
    memcpy(b->state.force[2], b->state.force[0], bytes);
    b->state.head->load_age = 2;
}

static sfem_status sfemi_body_check_nodes(const sfem_real *x, sfem_int nodes, const char *what,
                                          sfem_error *err)
{
    size_t i;
    for (i = 0; x && i < 3 * (size_t)nodes; ++i)
        if (!sfemi_finite(x[i]))
            return sfemi_fail_at(err, SFEM_NOT_FINITE, (sfem_int)(i / 3), -1,
                                 "the %s of node %d is not finite", what, (int)(i / 3));
    return SFEM_OK;
}

static sfem_status sfemi_body_check_node(const sfem_body *b, sfem_int node, const sfem_real *x,
                                         const char *what, sfem_error *err)
{
    if (node < 0 || node >= b->model->mesh.nodes)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "there is no node %d, the mesh has %d", (int)node,
                          (int)b->model->mesh.nodes);
    if (x && !sfemi_all_finite(x, 3))
        return sfemi_fail_at(err, SFEM_NOT_FINITE, node, -1, "the %s of node %d is not finite", what,
                             (int)node);
    return SFEM_OK;
}

SFEM_DEF sfem_status sfem_body_set_force(sfem_body *b, const sfem_real *force, sfem_error *err)
{
    const sfem_int nodes = b->model->mesh.nodes;
    const sfem_status status = sfemi_body_check_nodes(force, nodes, "force", err);
    if (status != SFEM_OK) return status;
    if (force) memcpy(b->state.force[0], force, 3 * (size_t)nodes * sizeof *force);
    else memset(b->state.force[0], 0, 3 * (size_t)nodes * sizeof *force);
    sfemi_body_load_changed(b);
    return SFEM_OK;
}

SFEM_DEF sfem_status sfem_body_add_node_force(sfem_body *b, sfem_int node, const sfem_real f[3],
                                              sfem_error *err)
{
    const sfem_status status = sfemi_body_check_node(b, node, f, "force", err);
    int c;
    if (status != SFEM_OK) return status;
    for (c = 0; c < 3; ++c) b->state.force[0][3 * (size_t)node + (size_t)c] += f[c];
    sfemi_body_load_changed(b);
    return SFEM_OK;
}

SFEM_DEF sfem_status sfem_body_set_gravity(sfem_body *b, const sfem_real g[3], sfem_error *err)
{
    if (!sfemi_all_finite(g, 3)) return sfemi_fail(err, SFEM_NOT_FINITE, "gravity is not finite");
    memcpy(b->state.head->gravity, g, 3 * sizeof *g);
    if (b->state.head->rebase == SFEMI_LEDGER) b->state.head->rebase = SFEMI_REBASE;
    return SFEM_OK;
}

SFEM_DEF const sfem_real *sfem_body_displacement(const sfem_body *b) { return b->state.u; }
SFEM_DEF sfem_real sfem_body_time(const sfem_body *b) { return b->state.head->time; }

SFEM_DEF void sfem_body_positions(const sfem_body *b, sfem_real *x)
{
    size_t i;
    for (i = 0; i < 3 * (size_t)b->model->mesh.nodes; ++i) x[i] = b->model->mesh.x[i] + b->state.u[i];
}

/* (p,q,r) keeps the mean velocity over a step: half a step of acceleration is missing from it. */
SFEM_DEF void sfem_body_velocities(const sfem_body *b, sfem_real *v)
{
    const sfemi_state *s = &b->state;
    const int mean = sfemi_body_keeps_mean(b) && s->head->started == SFEMI_RUNNING;
    const sfem_real half = mean ? s->head->h / 2 : 0;
    size_t i;
    for (i = 0; i < 3 * (size_t)b->model->mesh.nodes; ++i) v[i] = s->w[i] + half * s->a[i];
}

SFEM_DEF void sfem_body_to_floats(const sfem_body *b, float *x, float *v, size_t stride)
{
    const sfemi_state *s = &b->state;
    const int mean = sfemi_body_keeps_mean(b) && s->head->started == SFEMI_RUNNING;
    const sfem_real half = mean ? s->head->h / 2 : 0;
    size_t i, at;
    int c;
    SFEM_ASSERT(b && stride >= 3 * sizeof(float) && stride % sizeof(float) == 0);
    for (i = 0; i < (size_t)b->model->mesh.nodes; ++i)
        for (c = 0, at = 3 * i; c < 3; ++c, ++at) {
            const size_t to = i * (stride / sizeof(float)) + (size_t)c;
            if (x) x[to] = (float)(b->model->mesh.x[at] + s->u[at]);
            if (v) v[to] = (float)(s->w[at] + half * s->a[at]);
        }
}

/* Starts the integrator afresh from u and the velocity in w. */
static void sfemi_body_restart(sfem_body *b)
{
    const size_t bytes = 3 * (size_t)b->model->mesh.nodes * sizeof(sfem_real);
    sfem_int i;
    memset(b->state.a, 0, bytes);
    memcpy(b->state.force[1], b->state.force[0], bytes);
    memcpy(b->state.force[2], b->state.force[0], bytes);
    b->state.head->load_age = 2;
    b->state.head->started = SFEMI_NOT_STARTED;
    b->state.head->current = 0;
    b->state.head->steps = b->state.head->redone = b->state.head->descents = 0;
    for (i = 0; i < b->pin_count; ++i) b->state.pin[i].age = 0;
    for (i = 0; i < b->def.max_handles; ++i) b->state.handle[i].hold.age = 0;
    b->phase = SFEMI_IDLE;
}

SFEM_DEF sfem_status sfem_body_set_state(sfem_body *b, const sfem_real *u, const sfem_real *v,
                                         sfem_error *err)
{
    const sfem_int nodes = b->model->mesh.nodes;
    size_t i;
    sfem_status status = sfemi_body_check_nodes(u, nodes, "displacement", err);
    if (status == SFEM_OK) status = sfemi_body_check_nodes(v, nodes, "velocity", err);
    if (status != SFEM_OK) return status;
    for (i = 0; i < 3 * (size_t)nodes; ++i) {
        const int held = b->mask[i / 3] >> (i % 3) & 1;
        if (!held) b->state.u[i] = u ? u[i] : 0;
        b->state.w[i] = v && !held ? v[i] : 0;
    }
    sfemi_body_restart(b);
    return SFEM_OK;
}

SFEM_DEF size_t sfem_body_state_size(const sfem_body *b) { return (size_t)b->state.head->size; }

SFEM_DEF void sfem_body_save_state(const sfem_body *b, void *memory)
{
    const size_t bytes = sfem_body_state_size(b);
    uint32_t sum;
    memcpy(memory, b->state.head, bytes);
    sum = sfemi_state_checksum(memory, bytes);
    memcpy((char *)memory + offsetof(sfemi_state_head, checksum), &sum, sizeof sum);
}

SFEM_DEF sfem_status sfem_body_load_state(sfem_body *b, const void *memory, size_t bytes,
                                          sfem_error *err)
{
    sfemi_state_head head;
    if (bytes < sizeof head)
        return sfemi_fail(err, SFEM_FORMAT, "a state of %lu bytes is cut short", (unsigned long)bytes);
    memcpy(&head, memory, sizeof head);
    if (memcmp(head.magic, "sfemstat", 8) != 0)
        return sfemi_fail(err, SFEM_FORMAT, "this is no saved state");
    if (head.version != 1)
        return sfemi_fail(err, SFEM_FORMAT, "the state has version %u, this library reads 1",
                          (unsigned)head.version);
    if (head.size != bytes || head.checksum != sfemi_state_checksum(memory, bytes))
        return sfemi_fail(err, SFEM_FORMAT, "the saved state is damaged");
    if (head.size != b->state.head->size || head.key != b->state.head->key)
        return sfemi_fail(err, SFEM_MISMATCH, "the state is of a body with another mesh, pins or handles");
    memcpy(b->state.head, memory, bytes);
    b->state.head->checksum = 0;
    if (b->turns) sfemi_body_find_held(b);
    sfemi_body_forget_columns(b);
    b->phase = SFEMI_IDLE;
    return SFEM_OK;
}

/* ---- pins and handles ---- */

SFEM_DEF sfem_status sfem_body_set_pins(sfem_body *b, sfem_int count, const sfem_int *pins,
                                        const unsigned char *axes, sfem_error *err)
{
    const sfem_allocator *al = &b->allocator;
    const sfem_int nodes = b->model->mesh.nodes;
    sfemi_state fresh, old = b->state;
    unsigned char *mask = NULL;
    sfem_int *list = NULL, listed;
    void *block = NULL;
    size_t bytes;
    int k;
    sfem_status status = SFEM_OK;
    SFEMI_NEW(unsigned char, mask, al, nodes);
    SFEMI_NEW(sfem_int, list, al, count > 0 ? count : 1);
    SFEMI_TRY(sfemi_body_collect_pins(b, count, pins, axes, mask, list, &listed, err));
    bytes = sfemi_state_bytes(nodes, b->turns, listed, b->def.max_handles);
    SFEMI_NEW(char, block, al, bytes);
    sfemi_state_lay_out(&fresh, block, nodes, b->turns, listed);
    memcpy(fresh.head, old.head, sizeof *old.head + sfemi_state_reals(nodes, b->turns) * sizeof(sfem_real));
    memcpy(fresh.handle, old.handle, (size_t)b->def.max_handles * sizeof *old.handle);
    sfemi_delete(al, old.head);
    sfemi_delete(al, b->mask);
    sfemi_delete(al, b->pin);
    b->state = fresh;
    b->mask = mask;
    b->pin = list;
    b->pin_count = listed;
    b->omega_max = 0;
    sfemi_body_reset_head(b, bytes);
    b->phase = SFEMI_IDLE;
    sfemi_factor_release(b->model, b->factor);
    b->factor = NULL;
    for (k = 0; k < SFEMI_REDOS; ++k) {
        sfemi_factor_release(b->model, b->guard.redo[k].factor);
        b->guard.redo[k].factor = NULL;
    }
    sfemi_body_forget_columns(b);
    sfemi_body_place_pins(b);
    sfemi_body_held_changed(b);
    return SFEM_OK;
done:
    sfemi_delete(al, list);
    sfemi_delete(al, mask);
    return status;
}

SFEM_DEF sfem_status sfem_body_move_pin(sfem_body *b, sfem_int node, const sfem_real position[3],
                                        sfem_error *err)
{
    sfem_int k;
    sfem_status status = sfemi_body_check_node(b, node, position, "position", err);
    if (status != SFEM_OK) return status;
    for (k = 0; k < b->pin_count && b->pin[k] != node; ++k) continue;
    if (k == b->pin_count)
        return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, node, -1, "node %d is not pinned", (int)node);
    memcpy(b->state.pin[k].target, position, 3 * sizeof *position);
    return SFEM_OK;
}

/* Takes the first free handle for the weighted nodes. */
static sfem_status sfemi_body_grab(sfem_body *b, const sfem_int node[4], const sfem_real weight[4],
                                   sfem_int *handle, sfem_error *err)
{
    sfemi_handle *h = NULL;
    sfem_int k;
    int c, loose = 0;
    for (c = 0; c < 4; ++c) loose |= weight[c] != 0 && b->mask[node[c]] != SFEM_AXIS_ALL;
    if (!loose)
        return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, node[0], -1, "node %d is pinned on all axes",
                             (int)node[0]);
    for (k = 0; k < b->def.max_handles && b->state.handle[k].used; ++k) continue;
    if (k == b->def.max_handles)
        return sfemi_fail(err, SFEM_FULL, "all %d handles are in use: pin the nodes instead", (int)k);
    h = b->state.handle + k;
    memset(h, 0, sizeof *h);
    memcpy(h->node, node, sizeof h->node);
    memcpy(h->weight, weight, sizeof h->weight);
    h->used = 1;
    sfem_body_handle_position(b, k, h->hold.target);
    memcpy(h->hold.past, h->hold.target, sizeof h->hold.past);
    b->grip.ready[k] = 0;
    b->grip.dirty = 1;
    sfemi_body_held_changed(b);
    *handle = k;
    return SFEM_OK;
}

SFEM_DEF sfem_status sfem_body_grab_node(sfem_body *b, sfem_int node, sfem_int *handle, sfem_error *err)
{
    sfem_int nodes[4];
    const sfem_real weight[4] = {1, 0, 0, 0};
    const sfem_status status = sfemi_body_check_node(b, node, NULL, "", err);
    if (status != SFEM_OK) return status;
    nodes[0] = nodes[1] = nodes[2] = nodes[3] = node;
    return sfemi_body_grab(b, nodes, weight, handle, err);
}

SFEM_DEF sfem_status sfem_body_grab_point(sfem_body *b, sfem_int tet, const sfem_real bary[4],
                                          sfem_int *handle, sfem_error *err)
{
    if (tet < 0 || tet >= b->model->mesh.tets)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "there is no tet %d, the mesh has %d", (int)tet,
                          (int)b->model->mesh.tets);
    if (!sfemi_all_finite(bary, 4) || fabs(bary[0] + bary[1] + bary[2] + bary[3] - 1) > 1e-6)
        return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, -1, tet,
                             "barycentric coordinates %g %g %g %g do not add up to 1", bary[0], bary[1],
                             bary[2], bary[3]);
    return sfemi_body_grab(b, b->model->mesh.tet + 4 * (size_t)tet, bary, handle, err);
}

SFEM_DEF sfem_status sfem_body_move_handle(sfem_body *b, sfem_int handle, const sfem_real target[3],
                                           sfem_error *err)
{
    SFEM_ASSERT(handle >= 0 && handle < b->def.max_handles && b->state.handle[handle].used);
    if (!sfemi_all_finite(target, 3))
        return sfemi_fail(err, SFEM_NOT_FINITE, "the target of handle %d is not finite", (int)handle);
    memcpy(b->state.handle[handle].hold.target, target, 3 * sizeof *target);
    return SFEM_OK;
}

SFEM_DEF void sfem_body_release_handle(sfem_body *b, sfem_int handle)
{
    SFEM_ASSERT(handle >= 0 && handle < b->def.max_handles && b->state.handle[handle].used);
    memset(b->state.handle + handle, 0, sizeof *b->state.handle);
    b->phase = SFEMI_IDLE; /* a step under way still counts it in */
    b->grip.ready[handle] = 0;
    b->grip.dirty = 1;
    sfemi_body_held_changed(b);
}

SFEM_DEF void sfem_body_handle_force(const sfem_body *b, sfem_int handle, sfem_real force[3])
{
    SFEM_ASSERT(handle >= 0 && handle < b->def.max_handles && b->state.handle[handle].used);
    memcpy(force, b->state.handle[handle].force, 3 * sizeof *force);
}

SFEM_DEF void sfem_body_handle_position(const sfem_body *b, sfem_int handle, sfem_real x[3])
{
    sfem_real u[3];
    int c;
    SFEM_ASSERT(handle >= 0 && handle < b->def.max_handles && b->state.handle[handle].used);
    sfemi_grip_mean(b->state.handle + handle, b->model->mesh.x, x);
    sfemi_grip_mean(b->state.handle + handle, b->state.u, u);
    for (c = 0; c < 3; ++c) x[c] += u[c];
}

SFEM_DEF void sfem_body_reactions(sfem_body *b, sfem_real *force)
{
    const sfem_real load[3] = {1, 0, 0};
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const int inertia = b->model->block_mass != NULL || b->alpha != 0;
    sfem_real *v = b->acc;
    size_t i;
    sfem_body_velocities(b, v);
    if (sfemi_implicit_serves(b)) {
        memcpy(b->zm, b->state.a, n * sizeof *b->zm);
        b->phase = SFEMI_IDLE;
        sfemi_implicit_balance(b, 0, v, b->zm, b->rhs);
        for (i = 0; i < n; ++i) force[i] = b->mask[i / 3] >> (i % 3) & 1 ? -b->rhs[i] : 0;
        return;
    }
    for (i = 0; i < n; ++i) {
        b->zk[i] = b->state.u[i] + b->beta * v[i];
        b->zm[i] = b->state.a[i] + b->alpha * v[i];
        if (b->zd) b->zd[i] = v[i];
    }
    b->phase = SFEMI_IDLE;
    if (b->turns) {
        for (i = 0; i < n; ++i) b->zk[i] -= b->state.u[i];
        sfemi_guard_look(b);
        sfemi_turn_stiffness(b, b->state.u, b->state.frame, b->zk, b->zd, b->rhs);
        for (i = 0; i < n; ++i)
            b->rhs[i] += b->state.f[i] + b->model->node_mass[i / 3] * b->zm[i];
        sfemi_body_take_from_load(b, load, b->rhs, b->rhs);
    } else {
        sfemi_body_residual(b, load, inertia || b->state.head->started == SFEMI_RUNNING);
    }
    for (i = 0; i < n; ++i) force[i] = b->mask[i / 3] >> (i % 3) & 1 ? -b->rhs[i] : 0;
}

/* ---- statics ---- */

/* Is the handle one node's alone? Weights may be negative: a weight of 1 does not say so. */
static int sfemi_body_is_node_handle(const sfemi_handle *h)
{
    return h->used && h->weight[0] == 1 && h->weight[1] == 0 && h->weight[2] == 0 && h->weight[3] == 0;
}

/* The body's pins and its node handles: what a static solution has to hold. */
static void sfemi_body_static_mask(const sfem_body *b, unsigned char *mask)
{
    sfem_int k;
    memcpy(mask, b->mask, (size_t)b->model->mesh.nodes);
    for (k = 0; k < b->def.max_handles; ++k)
        if (sfemi_body_is_node_handle(b->state.handle + k))
            mask[b->state.handle[k].node[0]] = SFEM_AXIS_ALL;
}

/* Known displacements to u, zero elsewhere. Of two handles on one node the first counts, as in a step. */
static void sfemi_body_static_known(const sfem_body *b, sfem_real *u)
{
    const sfem_real *rest = b->model->mesh.x;
    sfem_int k;
    int c;
    memset(u, 0, 3 * (size_t)b->model->mesh.nodes * sizeof *u);
    for (k = b->def.max_handles - 1; k >= 0; --k) {
        const sfemi_handle *h = b->state.handle + k;
        const size_t at = 3 * (size_t)h->node[0];
        for (c = 0; sfemi_body_is_node_handle(h) && c < 3; ++c)
            u[at + (size_t)c] = h->hold.target[c] - rest[at + (size_t)c];
    }
    for (k = 0; k < b->pin_count; ++k)
        for (c = 0; c < 3; ++c) {
            const size_t at = 3 * (size_t)b->pin[k] + (size_t)c;
            if (b->mask[b->pin[k]] >> c & 1) u[at] = b->state.pin[k].target[c] - rest[at];
        }
}

/* Point handles through their dense block, on the static factor. Leaves the columns marked as belonging
 * to no factor of the body. */
static sfem_status sfemi_body_static_handles(sfem_body *b, const sfem_factor *f, sfem_real *u, int apply,
                                             sfem_error *err)
{
    sfemi_grip *g = &b->grip;
    sfem_status status = SFEM_OK;
    sfem_int k;
    g->count = 0;
    for (k = 0; k < b->def.max_handles; ++k) {
        const sfemi_handle *h = b->state.handle + k;
        g->ready[k] = 0;
        if (!h->used || sfemi_body_is_node_handle(h)) continue;
        SFEMI_TRY(sfemi_grip_reserve(b, g, k, err));
        if (apply) sfemi_grip_columns(f, h, b->model->mesh.nodes, 0, g->y[k], b->work, &b->exec);
        g->slot[g->count++] = k;
    }
    if (apply && g->count) {
        sfemi_grip_gather(g, b->state.handle, b->model, 0, f->mask);
        for (k = 0; k < g->count; ++k) {
            sfem_real rest[3];
            int c;
            sfemi_grip_mean(b->state.handle + g->slot[k], b->model->mesh.x, rest);
            for (c = 0; c < 3; ++c)
                g->lambda[3 * k + c] = b->state.handle[g->slot[k]].hold.target[c] - rest[c];
        }
        sfemi_grip_apply(g, b->state.handle, b->model->mesh.nodes, u);
        for (k = 0; k < g->count; ++k)
            memcpy(b->state.handle[g->slot[k]].force, g->lambda + 3 * k, 3 * sizeof(sfem_real));
    }
done:
    g->count = 0;
    g->dirty = 1;
    return status;
}

/* The forces of node handles: what is out of balance there, to the first handle of each node. */
static void sfemi_body_static_forces(sfem_body *b)
{
    const sfem_real load[3] = {1, 0, 0};
    sfem_int k;
    int c;
    memcpy(b->zk, b->state.u, 3 * (size_t)b->model->mesh.nodes * sizeof *b->zk);
    if (b->zd) memset(b->zd, 0, 3 * (size_t)b->model->mesh.nodes * sizeof *b->zd);
    if (sfemi_implicit_linear(b->model)) sfemi_body_residual(b, load, 0);
    else sfemi_implicit_balance(b, 0, NULL, NULL, b->rhs);
    for (k = 0; k < b->def.max_handles; ++k) {
        sfemi_handle *h = b->state.handle + k;
        for (c = 0; sfemi_body_is_node_handle(h) && c < 3; ++c) {
            const size_t i = 3 * (size_t)h->node[0] + (size_t)c;
            h->force[c] = b->mask[h->node[0]] >> c & 1 ? 0 : -b->rhs[i];
            b->rhs[i] = 0; /* carried */
        }
    }
}

/* The static solution of a nonlinear model, to acc. */
static sfem_status sfemi_body_static_newton(sfem_body *b, const sfemi_factor_key *key, sfem_error *err)
{
    sfemi_grip *g = &b->grip;
    sfemi_system system;
    sfem_status status = SFEM_OK;
    sfem_int k;
    memset(&system, 0, sizeof system);
    SFEMI_TRY(sfemi_implicit_reserve(b, err));
    SFEMI_TRY(sfemi_system_open(b, key, &system, err));
    SFEMI_TRY(sfemi_body_reserve_work(b, system.factor, 3, err));
    SFEMI_TRY(sfemi_body_static_handles(b, system.factor, NULL, 0, err));
    for (k = 0; k < b->def.max_handles; ++k)
        if (b->state.handle[k].used && !sfemi_body_is_node_handle(b->state.handle + k)) g->slot[g->count++] = k;
    sfemi_body_static_known(b, b->implicit.best);
    SFEMI_TRY(sfemi_implicit_equilibrium(b, &system, b->implicit.best, b->acc, err));
    for (k = 0; k < g->count; ++k)
        memcpy(b->state.handle[g->slot[k]].force, g->lambda + 3 * k, 3 * sizeof(sfem_real));
done:
    g->count = 0;
    g->dirty = 1;
    sfemi_factor_release(b->model, system.factor);
    sfemi_system_close(b, &system);
    return status;
}

SFEM_DEF sfem_status sfem_body_solve_static(sfem_body *b, sfem_error *err)
{
    const sfem_real load[3] = {1, 0, 0};
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfemi_factor_key key;
    unsigned char *mask = NULL;
    sfem_factor *f = NULL;
    sfem_status status = SFEM_OK;
    size_t i;
    SFEM_ASSERT(b);
    memset(&key, 0, sizeof key);
    b->phase = SFEMI_IDLE;
    SFEMI_NEW(unsigned char, mask, &b->allocator, b->model->mesh.nodes);
    sfemi_body_static_mask(b, mask);
    key.ck = 1;
    key.mask = mask;
    key.ordering = b->def.ordering;
    if (!sfemi_implicit_linear(b->model)) {
        SFEMI_TRY(sfemi_body_static_newton(b, &key, err));
    } else {
        SFEMI_TRY(sfemi_factor_get(b->model, &key, &b->exec, &f, &b->factors_made, err));
        SFEMI_TRY(sfemi_body_reserve_work(b, f, 3, err));
        SFEMI_TRY(sfemi_body_static_handles(b, f, NULL, 0, err));
        sfemi_body_static_known(b, b->zk);
        memcpy(b->acc, b->zk, n * sizeof *b->acc);
        if (b->zd) memset(b->zd, 0, n * sizeof *b->zd);
        sfemi_body_residual(b, load, 0);
        sfemi_factor_solve(f, b->model->mesh.nodes, 1, b->rhs, b->acc, b->work, &b->exec);
        SFEMI_TRY(sfemi_body_static_handles(b, f, b->acc, 1, err));
    }
    if (!sfemi_all_finite(b->acc, n)) {
        status = sfemi_fail(err, SFEM_NOT_FINITE, "the static solution is not finite");
        goto done;
    }
    for (i = 0; i < n; ++i) b->state.u[i] = b->acc[i];
    memset(b->state.w, 0, n * sizeof *b->state.w);
    sfemi_body_restart(b);
    sfemi_body_static_forces(b);
    for (i = 0; i < (size_t)b->pin_count; ++i)
        memcpy(b->state.pin[i].past, b->state.pin[i].target, sizeof b->state.pin[i].past);
done:
    sfemi_factor_release(b->model, b->static_factor);
    b->static_factor = f; /* kept: loads change more often than pins */
    sfemi_delete(&b->allocator, mask);
    return status;
}

/* ---- what a body tells ---- */

/* 1/2 x.M x, or x.K x with K's product in kx. */
static sfem_real sfemi_body_dot(const sfem_real *a, const sfem_real *b, size_t n)
{
    sfem_real sum = 0;
    size_t i;
    for (i = 0; i < n; ++i) sum += a[i] * b[i];
    return sum;
}

SFEM_DEF sfem_energy sfem_body_energy(sfem_body *b)
{
    const sfem_model *model = b->model;
    const sfemi_state *s = &b->state;
    const size_t n = 3 * (size_t)model->mesh.nodes;
    const sfem_real h = s->head->h, *force = s->force[0];
    const int running = s->head->started == SFEMI_RUNNING;
    sfem_energy e;
    size_t i;
    b->phase = SFEMI_IDLE;
    sfem_body_velocities(b, b->acc);
    sfem_model_multiply_mass(model, b->acc, b->zm, &b->exec);
    e.kinetic = sfemi_body_dot(b->acc, b->zm, n) / 2;
    if (b->turns) {
        e.elastic = s->head->current ? s->head->psi : sfemi_guard_forces(b, s->u, b->zk);
    } else if (sfemi_implicit_linear(model)) {
        sfem_model_multiply_stiffness(model, s->u, b->zk, &b->exec);
        e.elastic = sfemi_body_dot(s->u, b->zk, n) / 2;
    } else {
        e.elastic = sfemi_implicit_forces(b, s->u, b->zk);
    }
    e.load = 0;
    for (i = 0; i < n; ++i)
        e.load -= s->u[i] * (force[i] + model->node_mass[i / 3] * b->state.head->gravity[i % 3]);
    e.total = e.conserved = e.kinetic + e.elastic + e.load;
    if (b->turns) {
        sfemi_guard_look(b);
        e.conserved = s->head->steps ? s->head->energy
                                     : sfemi_guard_measure(b, s->u, s->w, s->f, s->head->psi, h).ec;
    }
    if (!running || b->turns) return e;
    if (!sfemi_body_keeps_mean(b)) {
        if (b->def.integrator != SFEM_NEWMARK) return e;
        sfem_model_multiply_mass(model, s->a, b->zm, &b->exec);
        e.conserved += (b->def.beta - 0.25) * h * h / 2 * sfemi_body_dot(s->a, b->zm, n);
    } else {
        const sfemi_coefficients k = sfemi_body_coefficients(b, b->p);
        sfem_real wkw, load_w = 0;
        sfem_model_multiply_mass(model, s->w, b->zm, &b->exec);
        sfem_model_multiply_stiffness(model, s->w, b->rhs, &b->exec);
        wkw = sfemi_body_dot(s->w, b->rhs, n);
        for (i = 0; i < n; ++i)
            load_w += s->w[i] * (force[i] + model->node_mass[i / 3] * b->state.head->gravity[i % 3]);
        /* with u- = u - h w: (E + E-)/2 = E - h/2 u.Kw + h^2/4 w.Kw and (u-u-).(f-f-) = h^2 w.Kw */
        e.conserved = k.r / 2 * sfemi_body_dot(s->w, b->zm, n) + k.p * h * h / 2 * wkw + e.elastic -
                      h / 2 * sfemi_body_dot(s->u, b->rhs, n) + e.load + h / 2 * load_w;
    }
    return e;
}

SFEM_DEF sfem_body_info sfem_body_get_info(const sfem_body *b)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_body_info info;
    sfem_int i;
    int k;
    memset(&info, 0, sizeof info);
    info.nodes = b->model->mesh.nodes;
    info.tets = b->model->mesh.tets;
    for (i = 0; i < info.nodes; ++i) info.free_nodes += b->mask[i] != SFEM_AXIS_ALL;
    info.p = b->factor ? b->p : 0;
    info.omega_max = b->omega_max;
    info.factors_made = b->factors_made;
    info.steps = b->state.head->steps;
    info.redone = b->state.head->redone;
    info.descents = b->state.head->descents;
    info.corrections = b->guard.corrections;
    info.body_bytes = (size_t)b->state.head->size + ((b->zd ? 5 : 4) * n + b->work_size) * sizeof(sfem_real);
    for (i = 0; i < b->def.max_handles; ++i) {
        info.body_bytes += 3 * n * (size_t)b->grip.parts[i] * sizeof(sfem_real);
        for (k = 0; b->turns && k < SFEMI_REDOS; ++k)
            info.body_bytes += 3 * n * (size_t)b->guard.redo[k].grip.parts[i] * sizeof(sfem_real);
    }
    if (b->turns) /* as sfemi_body_allocate_turn and sfemi_guard_prepare_redo lay it out */
        info.body_bytes += (9 * (size_t)info.tets + sfem_model_work_size(b->model) + n / 3 + 19 * n +
                            (b->guard.pair ? 2 * SFEMI_MEMORY * n : 0)) * sizeof(sfem_real);
    info.body_bytes += sfemi_implicit_bytes(b);
    if (!b->factor) return info;
    if (sfemi_pqr_needs_omega(b)) info.stable_step = sfemi_pqr_stable_step(b, b->p);
    info.diagonal = b->factor->inverse != NULL;
    if (b->factor->ldl) {
        const sfem_ldl_info ldl = sfem_ldl_get_info(b->factor->ldl);
        info.factor_nnz = ldl.nnz;
        info.factor_bytes = ldl.bytes;
    } else {
        info.factor_nnz = 3 * (size_t)b->factor->free_nodes;
        info.factor_bytes = info.factor_nnz * sizeof(sfem_real);
    }
    sfemi_lock(&b->model->lock);
    info.factor_users = b->factor->references;
    sfemi_unlock(&b->model->lock);
    return info;
}

/* ============================================================================================
 * >>modes   eigenvalues and modes
 * ============================================================================================ */

typedef struct sfemi_modes_kernels {
    void (*dots)(size_t, size_t, const double *, size_t, const double *, double *);
    void (*combine)(int, size_t, size_t, const double *, size_t, const double *, double *);
    void (*gram)(size_t, const double *, const double *, double *);
    void (*turn)(size_t, const double *, double *);
    void (*row)(int, int, int, const sfem_int *, const double *, const double *, const double *, double *);
    void (*project)(int, int, const double *, size_t, double *, double *);
    void (*scale)(const double *, const double *, double *);
} sfemi_modes_kernels;

static const sfemi_modes_kernels *sfemi_modes_kernels_of(int path)
{
#define SFEMI_TABLE(p)                                                                              \
    {sfemi_modes_dots_64_##p, sfemi_modes_combine_64_##p, sfemi_modes_gram_64_##p,                  \
     sfemi_modes_turn_64_##p, sfemi_modes_row_64_##p,     sfemi_modes_project_64_##p,               \
     sfemi_modes_scale_64_##p}
    static const sfemi_modes_kernels table[] = {
        SFEMI_TABLE(0),
#if SFEMI_X86
        SFEMI_TABLE(1),
        SFEMI_TABLE(2),
#endif
    };
#undef SFEMI_TABLE
    return table + path;
}

/* What the solvers work on: the free nodes, renumbered as they come. Held axes keep a row of their own
 * with K's diagonal in it and no mass, so that they are eigenvalues at infinity and never counted.
 * Blocks of four vectors stand interleaved, [3n][4], as the factor solves for them. */
typedef struct sfemi_modes_system {
    const sfem_model *model;
    const sfem_modes_def *def;
    const sfem_allocator *al;
    sfem_int n, axes;     /* free nodes; their free axes */
    sfem_int *node;       /* [n] numbers in the mesh */
    unsigned char *mask;  /* [nodes] axes held */
    sfem_matrix k;        /* K */
    sfem_real *mass;      /* [3n] lumped, 0 on held axes; or row sums */
    sfem_real *root;      /* [3n] its square root, where lumped; else NULL */
    sfem_real *scalar;    /* [blocks] consistent mass, or NULL */
    sfem_real norm_k, norm_m;
    sfem_int pieces, rigid;
    sfem_int *piece;      /* [n] */
    sfem_int *motions;    /* [pieces] rigid modes of each */
    sfem_real *z, *mz;    /* [6][3n] the k-th rigid mode of every piece, and M times it */
    sfem_real *half;      /* [6][3n] root(M) times it while Lanczos works on such, or NULL */
    sfem_real *dot;       /* [pieces][6][4] scratch */
} sfemi_modes_system;

static void sfemi_modes_system_free(sfemi_modes_system *s)
{
    sfem_matrix_free(&s->k, s->al);
    sfemi_delete(s->al, s->node);
    sfemi_delete(s->al, s->mask);
    sfemi_delete(s->al, s->mass);
    sfemi_delete(s->al, s->root);
    sfemi_delete(s->al, s->scalar);
    sfemi_delete(s->al, s->piece);
    sfemi_delete(s->al, s->motions);
    if (s->mz != s->z) sfemi_delete(s->al, s->mz);
    sfemi_delete(s->al, s->z);
    sfemi_delete(s->al, s->half);
    sfemi_delete(s->al, s->dot);
}

static sfem_status sfemi_modes_mask(sfemi_modes_system *s, sfem_error *err)
{
    const sfem_modes_def *def = s->def;
    const sfem_int nodes = s->model->mesh.nodes;
    sfem_status status = SFEM_OK;
    sfem_int i;
    int c;
    if (def->pin_count < 0 || (def->pin_count > 0 && !def->pins))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "pin_count is %d without pins", (int)def->pin_count);
    SFEMI_NEW(unsigned char, s->mask, s->al, nodes);
    for (i = 0; i < def->pin_count; ++i) {
        const sfem_int node = def->pins[i];
        const int held = def->pin_axes ? (int)def->pin_axes[i] : (int)SFEM_AXIS_ALL;
        if (node < 0 || node >= nodes)
            return sfemi_fail(err, SFEM_BAD_ARGUMENT, "pin %d names node %d, the mesh has %d", (int)i,
                              (int)node, (int)nodes);
        if (held < 1 || held > SFEM_AXIS_ALL)
            return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, node, -1,
                                 "pin %d holds axes %d, must be 1 to 7", (int)i, held);
        s->mask[node] = (unsigned char)(s->mask[node] | held);
    }
    for (i = 0; i < nodes; ++i) {
        if (s->model->node_mass[i] == 0) s->mask[i] = SFEM_AXIS_ALL;
        s->n += s->mask[i] != SFEM_AXIS_ALL;
    }
    SFEMI_NEW(sfem_int, s->node, s->al, s->n);
    for (s->n = i = 0; i < nodes; ++i) {
        if (s->mask[i] == SFEM_AXIS_ALL) continue;
        s->node[s->n++] = i;
        for (c = 0; c < 3; ++c) s->axes += !(s->mask[i] >> c & 1);
    }
done:
    return status;
}

/* K, M and their norms on the free nodes. */
static sfem_status sfemi_modes_matrices(sfemi_modes_system *s, sfem_error *err)
{
    const sfem_model *m = s->model;
    sfem_int *number = NULL, *row = NULL, *col = NULL, k, at, blocks = 0;
    sfem_real *sum = NULL;
    sfem_status status = SFEM_OK;
    size_t i;
    int r, c;
    SFEMI_NEW(sfem_int, number, s->al, m->mesh.nodes); /* 1 + its row, 0: not free */
    SFEMI_NEW(sfem_real, sum, s->al, 3 * (size_t)s->n);
    for (k = 0; k < s->n; ++k) number[s->node[k]] = k + 1;
    for (k = 0; k < s->n; ++k)
        for (at = m->row[s->node[k]]; at < m->row[s->node[k] + 1]; ++at)
            blocks += number[m->col[at]] > 0;
    SFEMI_TRY(sfemi_fem_new_matrix(s->n, (size_t)blocks, s->al, &row, &col, &s->k, err));
    SFEMI_NEW(sfem_real, s->mass, s->al, 3 * (size_t)s->n);
    if (m->block_mass)
        SFEMI_NEW(sfem_real, s->scalar, s->al, blocks);
    else
        SFEMI_NEW(sfem_real, s->root, s->al, 3 * (size_t)s->n);
    for (blocks = k = 0; k < s->n; ++k) {
        const sfem_int node = s->node[k];
        for (at = m->row[node]; at < m->row[node + 1]; ++at) {
            const sfem_int other = m->col[at], j = number[other] - 1;
            sfem_real *b = s->k.val + 9 * (size_t)blocks;
            if (j < 0) continue;
            memcpy(b, m->stiffness.val + 9 * (size_t)at, 9 * sizeof *b);
            for (r = 0; r < 3; ++r)
                for (c = 0; c < 3; ++c) {
                    if (((s->mask[node] >> r & 1) || (s->mask[other] >> c & 1)) && !(j == k && r == c))
                        b[3 * r + c] = 0;
                    sum[3 * (size_t)k + (size_t)r] += fabs(b[3 * r + c]);
                    if (j != k) sum[3 * (size_t)j + (size_t)c] += fabs(b[3 * r + c]);
                }
            if (s->scalar) s->scalar[blocks] = m->block_mass[at];
            col[blocks++] = j;
        }
        row[k + 1] = blocks;
        for (c = 0; c < 3; ++c) {
            const size_t at3 = 3 * (size_t)k + (size_t)c;
            s->mass[at3] = s->mask[node] >> c & 1 ? 0 : m->node_mass[node];
            s->norm_m = fmax(s->norm_m, s->mass[at3]);
            if (s->root) s->root[at3] = sqrt(s->mass[at3]);
        }
    }
    for (i = 0; i < 3 * (size_t)s->n; ++i) s->norm_k = fmax(s->norm_k, sum[i]);
done:
    sfemi_delete(s->al, number);
    sfemi_delete(s->al, sum);
    return status;
}

/* y = M x for four vectors that are zero on held axes. */
static void sfemi_modes_mass(const sfemi_modes_system *s, const sfem_real *x, sfem_real *y)
{
    const sfemi_modes_kernels *f = sfemi_modes_kernels_of(sfemi_path());
    const sfem_int *row = s->k.row;
    sfem_int i;
    size_t r;
    if (!s->scalar) {
        for (i = 0; i < s->n; ++i) f->scale(s->mass + 3 * (size_t)i, x + 12 * (size_t)i, y + 12 * (size_t)i);
        return;
    }
    memset(y, 0, 12 * (size_t)s->n * sizeof *y);
    for (i = 0; i < s->n; ++i) f->row(i, row[i], row[i + 1], s->k.col, s->k.val, s->scalar, x, y);
    for (r = 0; r < 3 * (size_t)s->n; ++r)
        if (s->mass[r] == 0) memset(y + 4 * r, 0, 4 * sizeof *y);
}

/* y = K x for four vectors. */
static void sfemi_modes_stiffness(const sfemi_modes_system *s, const sfem_real *x, sfem_real *y)
{
    const sfemi_modes_kernels *f = sfemi_modes_kernels_of(sfemi_path());
    const sfem_int *row = s->k.row;
    sfem_int i;
    memset(y, 0, 12 * (size_t)s->n * sizeof *y);
    for (i = 0; i < s->n; ++i) f->row(i, row[i], row[i + 1], s->k.col, s->k.val, NULL, x, y);
}

/* --- rigid modes ----------------------------------------------------------------------------- */

/* Pieces: what shares a tet, as sets with a representative; numbered by their first node. */
static sfem_status sfemi_modes_pieces(sfemi_modes_system *s, sfem_int *of, sfem_error *err)
{
    const sfem_mesh *mesh = &s->model->mesh;
    sfem_status status = SFEM_OK;
    sfem_int *number = NULL, i, k, e;
    int c;
    for (i = 0; i < mesh->nodes; ++i) of[i] = i;
    for (e = 0; e < mesh->tets; ++e)
        for (c = 1; c < 4; ++c) {
            sfem_int a = mesh->tet[4 * (size_t)e], b = mesh->tet[4 * (size_t)e + (size_t)c];
            while (of[a] != a) a = of[a] = of[of[a]];
            while (of[b] != b) b = of[b] = of[of[b]];
            if (a < b) of[b] = a;
            else of[a] = b;
        }
    SFEMI_NEW(sfem_int, number, s->al, mesh->nodes); /* 1 + piece of a representative */
    SFEMI_NEW(sfem_int, s->piece, s->al, s->n);
    for (i = 0; i < mesh->nodes; ++i) of[i] = of[of[i]]; /* roots come first: one step does */
    for (k = 0; k < s->n; ++k) {
        sfem_int *at = number + of[s->node[k]];
        if (!*at) *at = ++s->pieces;
        s->piece[k] = *at - 1;
    }
    for (i = 0; i < mesh->nodes; ++i) of[i] = number[of[i]] - 1; /* -1: nothing free there */
done:
    sfemi_delete(s->al, number);
    return status;
}

/* The six rigid motions of a place x - centre = r, as the columns of a 3x6 matrix. */
static void sfemi_modes_motion(const sfem_real *r, sfem_real *b)
{
    memset(b, 0, 18 * sizeof *b);
    b[0] = b[7] = b[14] = 1;
    b[4] = r[2];
    b[5] = -r[1];
    b[9] = -r[2];
    b[11] = r[0];
    b[15] = r[1];
    b[16] = -r[0];
}

/* Which of six motions the pins of a piece leave: the null space of the Gram matrix g [6][6] of its held
 * axes, as columns of motion [6][6]; returns how many. Where nothing is held, all of them as they are. */
static sfem_int sfemi_modes_allowed(sfem_real *g, sfem_real *motion)
{
    sfem_real value[6], work[30], trace = 0;
    sfem_int i, count = 0;
    for (i = 0; i < 6; ++i) trace += g[7 * i];
    memset(motion, 0, 36 * sizeof *motion);
    for (i = 0; i < 6; ++i) motion[7 * i] = 1;
    if (trace == 0) return 6;
    if (sfem_dense_eigen(6, g, NULL, value, work, NULL) != SFEM_OK) return 0; /* not finite: no mesh's */
    while (count < 6 && value[count] <= 1e-13 * trace) ++count;
    memcpy(motion, g, 36 * sizeof *motion);
    return count;
}

/* Takes the rigid part out of four vectors: x -= Z (MZ)^T x, piece by piece. Of root(M) times
 * displacements where s->half is set: then x -= root(M) Z (root(M) Z)^T x. */
static void sfemi_modes_deflate(const sfemi_modes_system *s, sfem_real *x)
{
    const sfemi_modes_kernels *f = sfemi_modes_kernels_of(sfemi_path());
    const size_t rows = 3 * (size_t)s->n;
    sfem_int i;
    if (s->rigid == 0) return;
    memset(s->dot, 0, 24 * (size_t)s->pieces * sizeof *s->dot);
    for (i = 0; i < s->n; ++i)
        f->project(0, s->motions[s->piece[i]], (s->half ? s->half : s->mz) + 3 * (size_t)i, rows,
                   x + 12 * (size_t)i, s->dot + 24 * (size_t)s->piece[i]);
    for (i = 0; i < s->n; ++i)
        f->project(1, s->motions[s->piece[i]], (s->half ? s->half : s->z) + 3 * (size_t)i, rows,
                   x + 12 * (size_t)i, s->dot + 24 * (size_t)s->piece[i]);
}

/* The k-th mode of every piece made M-orthogonal to those before it, twice, and of length 1. */
static void sfemi_modes_orthonormalise(sfemi_modes_system *s, sfem_real *x, sfem_real *y)
{
    const size_t rows = 3 * (size_t)s->n;
    sfem_int *motions = s->motions, i, p;
    size_t r;
    int k, j, turn;
    for (k = 0; k < 6; ++k) {
        sfem_real *z = s->z + (size_t)k * rows, *mz = s->mz + (size_t)k * rows;
        for (turn = 0; turn < 3; ++turn) {
            memset(s->dot, 0, 24 * (size_t)s->pieces * sizeof *s->dot);
            for (r = 0; r < rows; ++r) x[4 * r] = z[r];
            sfemi_modes_mass(s, x, y);
            for (r = 0; r < rows; ++r) mz[r] = y[4 * r];
            for (i = 0; i < s->n; ++i)
                for (j = 0; j <= k; ++j)
                    s->dot[24 * (size_t)s->piece[i] + (size_t)j] +=
                        sfemi_dot3(s->z + (size_t)j * rows + 3 * (size_t)i, mz + 3 * (size_t)i);
            for (i = 0; i < s->n; ++i) {
                const sfem_real *d = s->dot + 24 * (size_t)s->piece[i];
                if (k >= motions[s->piece[i]]) continue;
                for (r = 3 * (size_t)i; r < 3 * (size_t)i + 3; ++r) {
                    for (j = 0; j < k && turn < 2; ++j) z[r] -= d[j] * s->z[(size_t)j * rows + r];
                    if (turn == 2) z[r] /= sqrt(d[k]);
                    if (turn == 2) mz[r] /= sqrt(d[k]);
                }
            }
        }
    }
    for (p = 0; p < s->pieces; ++p) s->rigid += motions[p];
}

static sfem_status sfemi_modes_rigid(sfemi_modes_system *s, sfem_error *err)
{
    const sfem_mesh *mesh = &s->model->mesh;
    const size_t rows = 3 * (size_t)s->n;
    sfem_int *of = NULL, i, p;
    sfem_real *centre = NULL, *gram = NULL, *motion = NULL, *x = NULL, *y = NULL, r[3], b[18];
    sfem_status status = SFEM_OK;
    int c, j, k;
    SFEMI_NEW(sfem_int, of, s->al, mesh->nodes);
    SFEMI_TRY(sfemi_modes_pieces(s, of, err));
    SFEMI_NEW(sfem_real, centre, s->al, 5 * (size_t)s->pieces); /* with mass and radius */
    SFEMI_NEW(sfem_real, gram, s->al, 36 * (size_t)s->pieces);
    SFEMI_NEW(sfem_real, motion, s->al, 36 * (size_t)s->pieces);
    SFEMI_NEW(sfem_real, x, s->al, 4 * rows);
    SFEMI_NEW(sfem_real, y, s->al, 4 * rows);
    SFEMI_NEW(sfem_int, s->motions, s->al, s->pieces);
    SFEMI_NEW(sfem_real, s->dot, s->al, 24 * (size_t)s->pieces);
    SFEMI_NEW(sfem_real, s->z, s->al, 6 * rows);
    SFEMI_NEW(sfem_real, s->mz, s->al, 6 * rows);
    for (i = 0; i < mesh->nodes; ++i)
        for (c = 0; c < 3 && of[i] >= 0; ++c)
            centre[5 * of[i] + c] += s->model->node_mass[i] * mesh->x[3 * (size_t)i + (size_t)c];
    for (i = 0; i < mesh->nodes; ++i)
        if (of[i] >= 0) centre[5 * of[i] + 3] += s->model->node_mass[i];
    for (p = 0; p < s->pieces; ++p)
        for (c = 0; c < 3; ++c) centre[5 * p + c] /= centre[5 * p + 3];
    for (i = 0; i < mesh->nodes; ++i) {
        if (of[i] < 0) continue;
        sfemi_sub3(mesh->x + 3 * (size_t)i, centre + 5 * of[i], r);
        centre[5 * of[i] + 4] = fmax(centre[5 * of[i] + 4], sqrt(sfemi_dot3(r, r)));
    }
    for (i = 0; i < mesh->nodes; ++i) {
        if (of[i] < 0 || !s->mask[i]) continue;
        sfemi_sub3(mesh->x + 3 * (size_t)i, centre + 5 * of[i], r);
        for (c = 0; c < 3; ++c) r[c] /= centre[5 * of[i] + 4];
        sfemi_modes_motion(r, b);
        for (c = 0; c < 3; ++c)
            for (j = 0; j < 36 && (s->mask[i] >> c & 1); ++j)
                gram[36 * of[i] + j] += b[6 * c + j / 6] * b[6 * c + j % 6];
    }
    for (p = 0; p < s->pieces; ++p)
        s->motions[p] = sfemi_modes_allowed(gram + 36 * p, motion + 36 * p);
    for (i = 0; i < s->n; ++i) {
        p = s->piece[i];
        sfemi_sub3(mesh->x + 3 * (size_t)s->node[i], centre + 5 * p, r);
        for (c = 0; c < 3; ++c) r[c] /= centre[5 * p + 4];
        sfemi_modes_motion(r, b);
        for (k = 0; k < s->motions[p]; ++k)
            for (c = 0; c < 3; ++c) {
                sfem_real *z = s->z + (size_t)k * rows + 3 * (size_t)i + (size_t)c;
                for (j = 0; j < 6 && !(s->mask[s->node[i]] >> c & 1); ++j)
                    *z += b[6 * c + j] * motion[36 * p + 6 * k + j];
            }
    }
    sfemi_modes_orthonormalise(s, x, y);
done:
    sfemi_delete(s->al, of);
    sfemi_delete(s->al, centre);
    sfemi_delete(s->al, gram);
    sfemi_delete(s->al, motion);
    sfemi_delete(s->al, x);
    sfemi_delete(s->al, y);
    return status;
}

static sfem_status sfemi_modes_system_create(const sfem_model *model, const sfem_modes_def *def,
                                             sfemi_modes_system *s, sfem_error *err)
{
    sfem_status status;
    memset(s, 0, sizeof *s);
    s->model = model;
    s->def = def;
    s->al = &def->allocator;
    SFEMI_TRY(sfemi_modes_mask(s, err));
    SFEMI_TRY(sfemi_modes_matrices(s, err));
    SFEMI_TRY(sfemi_modes_rigid(s, err));
done:
    return status;
}

/* --- results --------------------------------------------------------------------------------- */

/* Room for so many elastic modes; the rigid ones are written, if wanted, piece by piece. */
static sfem_status sfemi_modes_result(const sfemi_modes_system *s, sfem_int elastic, sfem_modes *out,
                                      sfem_error *err)
{
    const size_t rows = 3 * (size_t)s->n, nodes3 = 3 * (size_t)s->model->mesh.nodes;
    sfem_status status = SFEM_OK;
    sfem_int p, k, i, at = 0;
    int c;
    out->nodes = s->model->mesh.nodes;
    out->rigid = s->def->rigid ? s->rigid : 0;
    out->count = out->rigid + elastic;
    SFEMI_NEW(sfem_real, out->lambda, s->al, out->count);
    SFEMI_NEW(sfem_real, out->error, s->al, out->count);
    SFEMI_NEW(sfem_real, out->phi, s->al, (size_t)out->count * nodes3);
    for (p = 0; p < s->pieces && out->rigid; at += s->motions[p++])
        for (i = 0; i < s->n; ++i)
            for (k = 0; k < s->motions[p] && s->piece[i] == p; ++k)
                for (c = 0; c < 3; ++c)
                    out->phi[(size_t)(at + k) * nodes3 + 3 * (size_t)s->node[i] + (size_t)c] =
                        s->z[(size_t)k * rows + 3 * (size_t)i + (size_t)c];
done:
    return status;
}

/* Backward errors of all modes, four at a time: a task is a block of modes. */
typedef struct sfemi_modes_measure {
    const sfemi_modes_system *s;
    sfem_modes *out;
    sfem_real *work; /* [blocks][3][3n][4] */
} sfemi_modes_measure;

static void sfemi_modes_measure_block(void *data, sfem_int block)
{
    const sfemi_modes_measure *job = (const sfemi_modes_measure *)data;
    const sfemi_modes_system *s = job->s;
    const size_t rows = 3 * (size_t)s->n, nodes3 = 3 * (size_t)job->out->nodes;
    const sfem_int first = 4 * block, left = job->out->count - first, some = left < 4 ? left : 4;
    sfem_real *x = job->work + 12 * rows * (size_t)block, *kx = x + 4 * rows, *mx = kx + 4 * rows;
    sfem_real rest[4], length[4];
    sfem_int i, q;
    size_t r;
    memset(rest, 0, sizeof rest);
    memset(length, 0, sizeof length);
    memset(x, 0, 4 * rows * sizeof *x);
    for (q = 0; q < some; ++q) {
        const sfem_real *phi = job->out->phi + (size_t)(first + q) * nodes3;
        for (i = 0; i < s->n; ++i)
            for (r = 0; r < 3; ++r)
                x[4 * (3 * (size_t)i + r) + (size_t)q] = phi[3 * (size_t)s->node[i] + r];
    }
    sfemi_modes_stiffness(s, x, kx);
    sfemi_modes_mass(s, x, mx);
    for (r = 0; r < rows; ++r)
        for (q = 0; q < some; ++q) {
            const size_t at = 4 * r + (size_t)q;
            const sfem_real d = kx[at] - job->out->lambda[first + q] * mx[at];
            rest[q] += d * d;
            length[q] += x[at] * x[at];
        }
    for (q = 0; q < some; ++q)
        job->out->error[first + q] =
            length[q] > 0 ? sqrt(rest[q] / length[q]) /
                                (s->norm_k + fabs(job->out->lambda[first + q]) * s->norm_m)
                          : 0;
}

static sfem_status sfemi_modes_errors(const sfemi_modes_system *s, sfem_modes *out, sfem_error *err)
{
    const sfem_int blocks = (out->count + 3) / 4;
    sfem_status status = SFEM_OK;
    sfemi_modes_measure job;
    job.s = s;
    job.out = out;
    SFEMI_NEW(sfem_real, job.work, s->al, (size_t)blocks * 36 * (size_t)s->n);
    sfemi_run(&s->def->exec, blocks, sfemi_modes_measure_block, &job);
    sfemi_delete(s->al, job.work);
done:
    return status;
}

static sfem_status sfemi_modes_too_many(const sfemi_modes_system *s, sfem_error *err)
{
    return sfemi_fail(err, SFEM_BAD_ARGUMENT,
                      "%d elastic modes asked for, but %d free axes less %d rigid modes leave %d",
                      (int)s->def->modes, (int)s->axes, (int)s->rigid, (int)(s->axes - s->rigid));
}

/* How many after the last of `taken` ascending values are equal to it. */
static sfem_int sfemi_modes_cut(const sfem_real *lambda, sfem_int taken, sfem_int count)
{
    sfem_int i = taken;
    while (taken > 0 && i < count && lambda[i] - lambda[taken - 1] <= 1e-6 * fabs(lambda[taken - 1]))
        ++i;
    return i - taken;
}

/* --- the dense solver ------------------------------------------------------------------------ */

/* A = K (lumped mass: root(M)^-1 K root(M)^-1) on the free axes, whose rows are in `axis`, and M in b.
 * Rigid modes are moved out of the way: A + beta (MZ)(MZ)^T, beta above all eigenvalues [Gershgorin;
 * a consistent mass is at least 1/5 of the lumped one]. */
static void sfemi_modes_fill(const sfemi_modes_system *s, const sfem_int *axis, sfem_real *a,
                             sfem_real *b)
{
    const size_t m = (size_t)s->axes, rows = 3 * (size_t)s->n;
    sfem_real beta = 0;
    sfem_int i, at;
    size_t r, q, p;
    int k, c, d;
    for (i = 0; i < s->n; ++i)
        for (at = s->k.row[i]; at < s->k.row[i + 1]; ++at)
            for (c = 0; c < 3; ++c)
                for (d = 0; d < 3; ++d) {
                    const size_t u = 3 * (size_t)i + (size_t)c, v = 3 * (size_t)s->k.col[at] + (size_t)d;
                    const sfem_int x = axis[u], y = axis[v];
                    if (x < 0 || y < 0 || x < y) continue;
                    a[(size_t)x + m * (size_t)y] = s->k.val[9 * (size_t)at + (size_t)(3 * c + d)] /
                                                   (b ? 1 : s->root[u] * s->root[v]);
                    if (b && c == d) b[(size_t)x + m * (size_t)y] = s->scalar[at];
                }
    if (s->rigid == 0) return;
    for (q = 0; q < m; ++q) { /* of A, or of A over the row sums of M */
        sfem_real sum = 0;
        for (p = 0; p < m; ++p) sum += fabs(p < q ? a[q + m * p] : a[p + m * q]);
        for (r = 0; b && r < rows; ++r)
            if (axis[r] == (sfem_int)q) sum *= 5 / s->mass[r];
        beta = fmax(beta, sum);
    }
    for (r = 0; r < rows; ++r)
        for (q = 0; q <= r; ++q) {
            sfem_real dot = 0;
            const sfem_int piece = s->piece[r / 3];
            if (axis[r] < 0 || axis[q] < 0 || s->piece[q / 3] != piece) continue;
            for (k = 0; k < s->motions[piece]; ++k)
                dot += s->mz[(size_t)k * rows + r] * s->mz[(size_t)k * rows + q];
            a[(size_t)axis[r] + m * (size_t)axis[q]] += beta * dot / (b ? 1 : s->root[r] * s->root[q]);
        }
}

/* Elastic modes ascending: improved eigenvalues may have changed places with their equals. */
static void sfemi_modes_sort(sfem_modes *out)
{
    const size_t nodes3 = 3 * (size_t)out->nodes;
    sfem_int i, k;
    size_t r;
    for (k = out->rigid; k < out->count; ++k)
        for (i = k; i > out->rigid && out->lambda[i] < out->lambda[i - 1]; --i) {
            sfem_real *p = out->phi + (size_t)i * nodes3, *o = p - nodes3, t = out->lambda[i];
            out->lambda[i] = out->lambda[i - 1];
            out->lambda[i - 1] = t;
            for (r = 0; r < nodes3; ++r) {
                t = p[r];
                p[r] = o[r];
                o[r] = t;
            }
        }
}

/* Rayleigh's quotient from the tets' own strains: better than the eigenvalue of a matrix whose largest
 * eigenvalue is far away. */
static void sfemi_modes_refine(const sfemi_modes_system *s, sfem_modes *out)
{
    sfem_int k;
    for (k = out->rigid; k < out->count; ++k)
        out->lambda[k] =
            2 * sfem_model_elastic_energy(s->model, out->phi + (size_t)k * 3 * (size_t)out->nodes);
    sfemi_modes_sort(out);
}

static sfem_status sfemi_modes_dense(const sfemi_modes_system *s, sfem_modes *out, sfem_error *err)
{
    const size_t m = (size_t)s->axes, rows = 3 * (size_t)s->n, nodes3 = 3 * (size_t)s->model->mesh.nodes;
    const sfem_real bound = s->def->below_hz * 6.283185307179586;
    sfem_real *a = NULL, *b = NULL, *lambda = NULL, *work = NULL;
    sfem_int *axis = NULL, elastic = s->axes - s->rigid, take = 0, k;
    sfem_status status = SFEM_OK;
    size_t r, q = 0;
    SFEMI_NEW(sfem_int, axis, s->al, rows);
    SFEMI_NEW(sfem_real, a, s->al, m * m);
    if (s->scalar) SFEMI_NEW(sfem_real, b, s->al, m * m);
    SFEMI_NEW(sfem_real, lambda, s->al, m);
    SFEMI_NEW(sfem_real, work, s->al, 5 * m);
    for (r = 0; r < rows; ++r) axis[r] = s->mask[s->node[r / 3]] >> (r % 3) & 1 ? -1 : (sfem_int)q++;
    sfemi_modes_fill(s, axis, a, b);
    SFEMI_TRY(sfem_dense_eigen(s->axes, a, b, lambda, work, err));
    if (s->def->below_hz > 0)
        while (take < elastic && lambda[take] < bound * bound) ++take;
    else
        take = s->def->modes;
    SFEMI_TRY(sfemi_modes_result(s, take, out, err));
    for (k = 0; k < take; ++k) {
        sfem_real *phi = out->phi + (size_t)(out->rigid + k) * nodes3;
        out->lambda[out->rigid + k] = lambda[k];
        for (r = 0; r < rows; ++r)
            if (axis[r] >= 0)
                phi[3 * (size_t)s->node[r / 3] + r % 3] =
                    a[(size_t)k * m + (size_t)axis[r]] / (b ? 1 : s->root[r]);
    }
    sfemi_modes_refine(s, out);
    SFEMI_TRY(sfemi_modes_errors(s, out, err));
    out->info.dense = out->info.proved = 1;
    out->info.converged = take;
    out->info.cut = sfemi_modes_cut(lambda, take, elastic);
    out->info.below = s->rigid + take + out->info.cut;
    out->info.bound = s->def->below_hz > 0 ? bound * bound
                      : take > 0           ? lambda[take + out->info.cut - 1] * (1 + 1e-6)
                                           : 0;
done:
    sfemi_delete(s->al, axis);
    sfemi_delete(s->al, a);
    sfemi_delete(s->al, b);
    sfemi_delete(s->al, lambda);
    sfemi_delete(s->al, work);
    return status;
}

/* --- block Lanczos ---------------------------------------------------------------------------
 *
 * With lumped mass the operator is root(M) (K - sigma M)^-1 root(M) and the basis orthonormal; with a
 * consistent one (K - sigma M)^-1 M, and the basis M-orthonormal. A step turns the newest block Q_j of
 * the basis V into W = Op Q_j less its part in V; W = Q_j+1 R; the coefficients V^T Op Q_j are a column
 * of T = V^T Op V, so that T needs no special form after a restart. Its Ritz pairs (theta, s) have
 * residuals |R s_last|, and lambda = sigma + 1/theta. */
#define SFEMI_MODES_CHUNK 1920 /* rows to a task: fixed, so that sums do not depend on threads */

typedef struct sfemi_lanczos {
    sfemi_modes_system *s;
    const sfemi_modes_kernels *f;
    const sfem_exec *exec;
    sfem_modes_info *info;
    sfem_ldl *ldl;
    sfem_matrix a;       /* K - sigma M; shares its pattern with K */
    size_t rows, padded; /* 3n, and that in multiples of 24 */
    sfem_int chunks, panels, capacity, wanted, m;
    int fresh;           /* the newest block has just been put behind a restart's */
    sfem_real sigma, top;
    sfem_real *v;        /* [panels][padded][24] the basis */
    sfem_real *w;        /* [padded][4] the newest block */
    sfem_real *mw;       /* [padded][4] M times it; w itself where the mass is lumped */
    sfem_real *work;     /* of solves */
    sfem_real *c, *part; /* [24 panels][4], and such for each chunk */
    sfem_real *t;        /* [capacity][capacity] column-major, upper half */
    sfem_real *ritz;     /* [capacity][capacity] eigenvectors of T */
    sfem_real *theta, *rho; /* [capacity] Ritz values, falling, and residuals */
    sfem_real *small;    /* scratch of eigenvalues */
    sfem_real *ax;       /* [3][padded][4] scratch */
    sfem_real gain;      /* backward error of a mode over rho / theta, from above */
    int vectors;         /* ritz holds eigenvectors of T as it is */
    sfem_real r[16];     /* R, row-major */
    uint64_t random;
} sfemi_lanczos;

static void sfemi_lanczos_free(sfemi_lanczos *z)
{
    const sfem_allocator *al = z->s->al;
    sfem_ldl_free(z->ldl);
    sfemi_delete(al, z->a.val);
    sfemi_delete(al, z->v);
    if (z->mw != z->w) sfemi_delete(al, z->mw);
    sfemi_delete(al, z->w);
    sfemi_delete(al, z->work);
    sfemi_delete(al, z->c);
    sfemi_delete(al, z->part);
    sfemi_delete(al, z->t);
    sfemi_delete(al, z->ritz);
    sfemi_delete(al, z->theta);
    sfemi_delete(al, z->rho);
    sfemi_delete(al, z->small);
    sfemi_delete(al, z->ax);
}

typedef struct sfemi_lanczos_job {
    const sfemi_lanczos *z;
    sfem_int first, panels; /* of the basis */
    int minus;
    const sfem_real *c;
    sfem_real *w;
    sfem_int kept; /* columns that sfemi_lanczos_compress makes */
} sfemi_lanczos_job;

static size_t sfemi_lanczos_rows(const sfemi_lanczos *z, sfem_int chunk)
{
    const size_t left = z->padded - (size_t)chunk * SFEMI_MODES_CHUNK;
    return left < SFEMI_MODES_CHUNK ? left : SFEMI_MODES_CHUNK;
}

static void sfemi_lanczos_dots_chunk(void *data, sfem_int chunk)
{
    const sfemi_lanczos_job *job = (const sfemi_lanczos_job *)data;
    const sfemi_lanczos *z = job->z;
    const size_t at = (size_t)chunk * SFEMI_MODES_CHUNK, size = 96 * (size_t)job->panels;
    sfem_real *part = z->part + (size_t)chunk * 96 * (size_t)z->panels;
    memset(part, 0, size * sizeof *part);
    z->f->dots(sfemi_lanczos_rows(z, chunk), (size_t)job->panels,
               z->v + (size_t)job->first * 24 * z->padded + 24 * at, 24 * z->padded, z->mw + 4 * at, part);
}

static void sfemi_lanczos_combine_chunk(void *data, sfem_int chunk)
{
    const sfemi_lanczos_job *job = (const sfemi_lanczos_job *)data;
    const sfemi_lanczos *z = job->z;
    const size_t at = (size_t)chunk * SFEMI_MODES_CHUNK;
    z->f->combine(job->minus, sfemi_lanczos_rows(z, chunk), (size_t)job->panels,
                  z->v + (size_t)job->first * 24 * z->padded + 24 * at, 24 * z->padded, job->c,
                  job->w + 4 * at);
}

/* MW = M W */
static void sfemi_lanczos_mass(sfemi_lanczos *z)
{
    if (z->mw != z->w) sfemi_modes_mass(z->s, z->w, z->mw);
}

/* c = V^T MW for the job's panels. */
static void sfemi_lanczos_dots(sfemi_lanczos *z, sfemi_lanczos_job *job)
{
    const size_t size = 96 * (size_t)job->panels;
    sfem_int k;
    size_t i;
    sfemi_run(z->exec, z->chunks, sfemi_lanczos_dots_chunk, job);
    memset(z->c, 0, size * sizeof *z->c);
    for (k = 0; k < z->chunks; ++k)
        for (i = 0; i < size; ++i) z->c[i] += z->part[(size_t)k * 96 * (size_t)z->panels + i];
    for (i = 4 * (size_t)(z->m - 24 * job->first); i < size; ++i) z->c[i] = 0; /* no vectors there */
}

/* W -= V V^T M W with the panels that hold the columns from `first` on; T's newest columns, at `column`,
 * get what is taken out. */
static void sfemi_lanczos_orthogonalise(sfemi_lanczos *z, sfem_int first, sfem_int column)
{
    sfemi_lanczos_job job;
    sfem_int k;
    int q;
    if (z->m == 0) return;
    job.z = z;
    job.first = first / 24;
    job.panels = (z->m + 23) / 24 - job.first;
    job.minus = 1;
    job.c = z->c;
    job.w = z->w;
    job.kept = 0;
    sfemi_lanczos_mass(z);
    sfemi_lanczos_dots(z, &job);
    sfemi_run(z->exec, z->chunks, sfemi_lanczos_combine_chunk, &job);
    for (k = 24 * job.first; column >= 0 && k < z->m; ++k)
        for (q = 0; q < 4; ++q)
            z->t[(size_t)k + (size_t)(column + q) * (size_t)z->capacity] +=
                z->c[4 * (k - 24 * job.first) + q];
}

/* x = (the factorised matrix)^-1 b; with root, x = root (..)^-1 root b. */
static void sfemi_lanczos_solve(sfemi_lanczos *z, const sfem_real *root, const sfem_real *b, sfem_real *x)
{
    const sfemi_symbolic *y = z->ldl->symbolic;
    sfemi_solve q;
    sfem_int i;
    memset(&q, 0, sizeof q);
    q.ldl = z->ldl;
    q.block = 4;
    q.pace = z->ldl->pace + 2;
    q.w = z->work;
    q.scratch = z->work + sfemi_solve_rows(y) * q.block;
    q.done = (sfemi_counter *)(void *)(q.scratch + y->scratch[y->tasks] * SFEMI_SOLVE_SCRATCH);
    for (i = 0; i < y->n; ++i) {
        const size_t at = (size_t)y->order[i];
        if (root) z->f->scale(root + 3 * at, b + 12 * at, q.w + 12 * (size_t)i);
        else memcpy(q.w + 12 * (size_t)i, b + 12 * at, 12 * sizeof *q.w);
    }
    sfemi_solve_sweeps(&q, z->exec, sfemi_solve_forward, sfemi_solve_backward);
    for (i = 0; i < y->n; ++i) {
        const size_t at = (size_t)y->order[i];
        if (root) z->f->scale(root + 3 * at, q.w + 12 * (size_t)i, x + 12 * at);
        else memcpy(x + 12 * at, q.w + 12 * (size_t)i, 12 * sizeof *q.w);
    }
    z->info->solves += 4;
}

/* Random numbers in columns of W, zero on held axes. */
static void sfemi_lanczos_scatter(sfemi_lanczos *z, const int *bad)
{
    size_t r;
    int q;
    for (r = 0; r < z->rows; ++r)
        for (q = 0; q < 4; ++q)
            if (bad[q]) {
                z->random = z->random * 6364136223846793005u + 1442695040888963407u;
                z->w[4 * r + (size_t)q] =
                    z->s->mass[r] == 0 ? 0 : (sfem_real)(z->random >> 11) / 9007199254740992.0 - 0.5;
            }
}

/* One pass of W = Q R by Cholesky of the Gram matrix; columns that hang on others, or are below `least`
 * in length, are marked: their row of R is 0. Returns how far R was from the identity. */
static sfem_real sfemi_lanczos_cholesky(sfemi_lanczos *z, sfem_real least, sfem_real *r, int *bad)
{
    sfem_real g[48], inverse[16], unit[4], far = 0;
    int i, j, k;
    memset(g, 0, sizeof g);
    sfemi_lanczos_mass(z);
    z->f->gram(z->padded, z->w, z->mw, g);
    memset(r, 0, 16 * sizeof *r);
    memset(inverse, 0, sizeof inverse);
    for (i = 0; i < 4; ++i) unit[i] = g[5 * i];
    for (i = 0; i < 4; ++i) {
        bad[i] = !(g[5 * i] > 1e-9 * unit[i]) || !(unit[i] > least * least);
        if (bad[i]) continue;
        r[5 * i] = sqrt(g[5 * i]);
        for (j = i + 1; j < 4; ++j) r[4 * i + j] = g[4 * i + j] / r[5 * i];
        for (j = i + 1; j < 4; ++j)
            for (k = j; k < 4; ++k) g[4 * j + k] -= r[4 * i + j] * r[4 * i + k];
    }
    for (i = 0; i < 4; ++i)
        for (j = i; j < 4; ++j) far = fmax(far, fabs(r[4 * i + j] - (i == j)));
    for (j = 0; j < 4; ++j) {
        if (bad[j]) continue;
        inverse[5 * j] = 1 / r[5 * j];
        for (i = j; i-- > 0;) {
            for (k = i + 1; k <= j; ++k) inverse[4 * i + j] -= r[4 * i + k] * inverse[4 * k + j];
            if (!bad[i]) inverse[4 * i + j] /= r[5 * i];
            else inverse[4 * i + j] = 0;
        }
    }
    z->f->turn(z->padded, inverse, z->w);
    if (z->mw != z->w) z->f->turn(z->padded, inverse, z->mw);
    return far;
}

/* W = Q R, R to z->r. Columns that are lost in rounding become random ones, orthogonal to the rest. */
static void sfemi_lanczos_normalise(sfemi_lanczos *z, sfem_real least)
{
    sfem_real r[16], product[16], far;
    int bad[4], lost, i, j, k, pass;
    for (i = 0; i < 16; ++i) z->r[i] = i % 5 == 0;
    for (pass = 0; pass < 8; ++pass) {
        far = sfemi_lanczos_cholesky(z, pass ? 0 : least, r, bad);
        memset(product, 0, sizeof product);
        for (i = 0; i < 4; ++i)
            for (k = i; k < 4; ++k)
                for (j = k; j < 4; ++j) product[4 * i + j] += r[4 * i + k] * z->r[4 * k + j];
        memcpy(z->r, product, sizeof product);
        for (lost = i = 0; i < 4; ++i) lost += bad[i];
        if (lost) {
            sfemi_lanczos_scatter(z, bad);
            for (i = 0; i < 2; ++i) {
                sfemi_modes_deflate(z->s, z->w);
                sfemi_lanczos_orthogonalise(z, 0, -1);
            }
        } else if (far < 1e-6)
            break;
    }
}

/* Columns of V from `at` on, four at most, = those of W, or 0. */
static void sfemi_lanczos_put(sfemi_lanczos *z, sfem_int at, sfem_int count, const sfem_real *w)
{
    size_t r;
    sfem_int q;
    for (q = 0; q < count; ++q) {
        sfem_real *to = z->v + (size_t)((at + q) / 24) * 24 * z->padded + (size_t)((at + q) % 24);
        for (r = 0; r < z->padded; ++r) to[24 * r] = w ? w[4 * r + (size_t)q] : 0;
    }
}

/* Puts W behind the basis. */
static void sfemi_lanczos_append(sfemi_lanczos *z)
{
    sfemi_lanczos_put(z, z->m, 4, z->w);
    z->m += 4;
    z->vectors = 0;
    if (z->m > z->info->basis) z->info->basis = z->m;
}

/* T gets the columns of the newest block, W the next one. The recurrence comes first: what is then left
 * in the rest of the basis is of the size of rounding, so that one pass over all of it does; after a
 * restart two. */
static void sfemi_lanczos_step(sfemi_lanczos *z)
{
    const sfem_int column = z->m - 4;
    sfem_int q;
    for (q = 0; q < 4; ++q)
        memset(z->t + (size_t)(column + q) * (size_t)z->capacity, 0, (size_t)z->capacity * sizeof *z->t);
    sfemi_lanczos_solve(z, z->s->root, z->mw, z->w);
    ++z->info->steps;
    sfemi_modes_deflate(z->s, z->w);
    sfemi_lanczos_orthogonalise(z, z->fresh || z->m < 12 ? 0 : z->m - 8, column);
    sfemi_lanczos_orthogonalise(z, 0, column);
    sfemi_modes_deflate(z->s, z->w);
    for (q = 0; q < 4; ++q)
        z->top = fmax(z->top, fabs(z->t[(size_t)(column + q) * ((size_t)z->capacity + 1)]));
    sfemi_lanczos_normalise(z, 1e-14 * z->top);
    z->fresh = z->vectors = 0;
}

/* |R s| for the last four numbers of an eigenvector of T. */
static sfem_real sfemi_lanczos_residual(const sfemi_lanczos *z, const sfem_real *s)
{
    sfem_real sum = 0;
    int i, j;
    for (i = 0; i < 4; ++i) {
        sfem_real d = 0;
        for (j = i; j < 4; ++j) d += z->r[4 * i + j] * s[j];
        sum += d * d;
    }
    return sqrt(sum);
}

/* T's lower half to `to` [m][m]. */
static void sfemi_lanczos_copy(const sfemi_lanczos *z, sfem_real *to)
{
    const size_t m = (size_t)z->m, h = (size_t)z->capacity;
    size_t i, j;
    for (j = 0; j < m; ++j)
        for (i = j; i < m; ++i) to[i + j * m] = z->t[j + i * h];
}

/* theta and rho, falling, by the eigenvalues of T and the last four numbers of its eigenvectors. */
static int sfemi_lanczos_values(sfemi_lanczos *z)
{
    const size_t m = (size_t)z->m;
    sfem_real *d = z->theta, *e = z->small, *tau = e + m, *work = tau + m, *rows = work + 3 * m, *x;
    size_t i, k;
    int q;
    z->vectors = 0;
    sfemi_lanczos_copy(z, z->ritz);
    sfemi_eigen_reduce(m, z->ritz, d, e, tau, work);
    for (q = 0; q < 4; ++q) { /* the last rows of Q = H_0 H_1 ...: rows [m][4] */
        x = work;
        memset(x, 0, m * sizeof *x);
        x[m - 4 + (size_t)q] = 1;
        for (k = 0; k + 1 < m; ++k)
            sfemi_eigen_kernels_of(sfemi_path())
                ->reflect(m - k - 1, z->ritz + k * m + k + 1, tau[k], x + k + 1);
        for (i = 0; i < m; ++i) rows[4 * i + (size_t)q] = x[i];
    }
    if (!sfemi_eigen_ql(m, d, e, 4, rows, 4, work)) return 0;
    for (i = 0; i < m; ++i) d[i] = -d[i];
    sfemi_eigen_sort(m, d, 4, rows, 4);
    for (i = 0; i < m; ++i) {
        d[i] = -d[i];
        z->rho[i] = sfemi_lanczos_residual(z, rows + 4 * i);
    }
    return 1;
}

/* The same with all eigenvectors, in z->ritz, largest theta first. */
static int sfemi_lanczos_vectors(sfemi_lanczos *z)
{
    const size_t m = (size_t)z->m;
    sfem_real *a = z->ritz;
    size_t i, j;
    if (z->vectors) return 1;
    sfemi_lanczos_copy(z, a);
    for (j = 0; j < m; ++j)
        for (i = j; i < m; ++i) a[i + j * m] = -a[i + j * m];
    if (sfem_dense_eigen((sfem_int)m, a, NULL, z->theta, z->small, NULL) != SFEM_OK) return 0;
    for (i = 0; i < m; ++i) {
        z->theta[i] = -z->theta[i];
        z->rho[i] = sfemi_lanczos_residual(z, a + i * m + m - 4);
    }
    z->vectors = 1;
    return 1;
}

/* c [24 panels][4] = four columns of ritz from `first` on, those from `end` on 0. */
static void sfemi_lanczos_pick(const sfemi_lanczos *z, sfem_int first, sfem_int end, sfem_real *c)
{
    sfem_int i, q;
    memset(c, 0, 96 * (size_t)z->panels * sizeof *c);
    for (q = 0; q < 4 && first + q < end; ++q)
        for (i = 0; i < z->m; ++i) c[4 * i + q] = z->ritz[(size_t)(first + q) * (size_t)z->m + (size_t)i];
}

/* V = V S in place, 96 rows at a time: c holds the blocks of S, one behind the other. */
static void sfemi_lanczos_compress_chunk(void *data, sfem_int chunk)
{
    const sfemi_lanczos_job *job = (const sfemi_lanczos_job *)data;
    const sfemi_lanczos *z = job->z;
    const size_t start = (size_t)chunk * SFEMI_MODES_CHUNK, rows = sfemi_lanczos_rows(z, chunk);
    const size_t size = 96 * (size_t)z->panels;
    sfem_real *to = job->w + (size_t)chunk * 96 * 24 * (size_t)z->panels;
    size_t at, r;
    sfem_int k, q;
    for (at = start; at < start + rows; at += 96) {
        const size_t some = start + rows - at < 96 ? start + rows - at : 96;
        memset(to, 0, 96 * 24 * (size_t)z->panels * sizeof *to);
        for (k = 0; k < job->kept; k += 4)
            z->f->combine(0, some, (size_t)job->panels, z->v + 24 * at, 24 * z->padded,
                          job->c + size * (size_t)(k / 4), to + 96 * (size_t)k);
        for (k = 0; k < 24 * job->panels; ++k) {
            sfem_real *v = z->v + (size_t)(k / 24) * 24 * z->padded + 24 * at + (size_t)(k % 24);
            const sfem_real *from = to + 96 * (size_t)(k / 4 * 4);
            q = k % 4;
            for (r = 0; r < some; ++r) v[24 * r] = k < job->kept ? from[4 * r + (size_t)q] : 0;
        }
    }
}

/* A thick restart: the basis becomes the first `keep` Ritz vectors, T their values. */
static sfem_status sfemi_lanczos_restart(sfemi_lanczos *z, sfem_int keep, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfemi_lanczos_job job;
    sfem_real *c = NULL, *to = NULL;
    sfem_int k;
    if (!sfemi_lanczos_vectors(z))
        return sfemi_fail(err, SFEM_NOT_CONVERGED, "an eigenvalue of the Lanczos matrix does not converge");
    SFEMI_NEW(sfem_real, c, z->s->al, 96 * (size_t)z->panels * ((size_t)keep / 4 + 1));
    SFEMI_NEW(sfem_real, to, z->s->al, 96 * 24 * (size_t)z->panels * (size_t)z->chunks);
    for (k = 0; k < keep; k += 4)
        sfemi_lanczos_pick(z, k, keep, c + 96 * (size_t)z->panels * (size_t)(k / 4));
    job.z = z;
    job.first = 0;
    job.panels = (z->m + 23) / 24;
    job.minus = 0;
    job.c = c;
    job.w = to;
    job.kept = keep;
    sfemi_run(z->exec, z->chunks, sfemi_lanczos_compress_chunk, &job);
    memset(z->t, 0, (size_t)z->capacity * (size_t)z->capacity * sizeof *z->t);
    for (k = 0; k < keep; ++k) z->t[(size_t)k * ((size_t)z->capacity + 1)] = z->theta[k];
    z->m = keep;
    z->fresh = 1;
    z->vectors = 0;
    ++z->info->restarts;
done:
    sfemi_delete(z->s->al, c);
    sfemi_delete(z->s->al, to);
    return status;
}

/* A random block, orthogonal to all that the basis holds, as the newest. */
static void sfemi_lanczos_begin(sfemi_lanczos *z)
{
    static const int all[4] = {1, 1, 1, 1};
    int turn;
    sfemi_lanczos_scatter(z, all);
    for (turn = 0; turn < 2; ++turn) {
        sfemi_modes_deflate(z->s, z->w);
        sfemi_lanczos_orthogonalise(z, 0, -1);
    }
    sfemi_lanczos_normalise(z, 0);
    memset(z->r, 0, sizeof z->r);
    sfemi_lanczos_append(z);
    z->fresh = 1;
}

static sfem_real sfemi_lanczos_lambda(const sfemi_lanczos *z, sfem_real theta)
{
    return theta > 0 ? z->sigma + 1 / theta : HUGE_VAL;
}

/* The residual K phi - lambda M phi of a Ritz vector is A U R s / theta, U the next block as
 * displacements and R s its coefficients, whose length is rho; and |phi| >= |M|^-1/2. */
static void sfemi_lanczos_gain(sfemi_lanczos *z)
{
    const sfemi_modes_system *s = z->s;
    sfem_real *x = z->ax, *y = x + 4 * z->padded, sum = 0;
    sfem_int i;
    size_t r;
    int q;
    for (r = 0; r < z->rows; ++r)
        for (q = 0; q < 4; ++q)
            x[4 * r + (size_t)q] =
                s->mass[r] == 0 ? 0 : z->w[4 * r + (size_t)q] / (s->root ? s->root[r] : 1);
    memset(y, 0, 4 * z->rows * sizeof *y);
    for (i = 0; i < s->n; ++i)
        z->f->row(i, s->k.row[i], s->k.row[i + 1], s->k.col, z->a.val, NULL, x, y);
    for (r = 0; r < 4 * z->rows; ++r) sum += y[r] * y[r];
    z->gain = sqrt(sum * s->norm_m) / s->norm_k;
}

/* The largest backward error of the first `count`, or HUGE_VAL. */
static sfem_real sfemi_lanczos_worst(sfemi_lanczos *z, sfem_int count)
{
    sfem_real worst = 0;
    sfem_int i;
    if (count > z->m) return HUGE_VAL;
    sfemi_lanczos_gain(z);
    for (i = 0; i < count; ++i) {
        if (!(z->theta[i] > 0)) return HUGE_VAL;
        worst = fmax(worst, z->gain * z->rho[i] / z->theta[i]);
    }
    return worst;
}

/* A place in the gap above the wanted values, 0 if there is none yet: above the cluster, if any, that the
 * last of them belongs to, and below what the next one may be. *end: Ritz values below it. */
static int sfemi_lanczos_gap(const sfemi_lanczos *z, int attempt, sfem_real *bound, sfem_int *end)
{
    static const sfem_real part[5] = {0.5, 0.3, 0.7, 0.1, 0.9};
    sfem_int i;
    for (i = z->wanted; i < z->m; ++i) {
        const sfem_real low = sfemi_lanczos_lambda(z, z->theta[i - 1]);
        const sfem_real high = sfemi_lanczos_lambda(z, z->theta[i] + z->rho[i]);
        if (!(z->rho[i - 1] <= 1e-5 * z->theta[i - 1])) return 0;
        if (!(high - low > 1e-6 * fabs(low))) continue;
        *bound = low + part[attempt] * fmin(high - low, 0.05 * fabs(low));
        *end = i;
        return 1;
    }
    return 0;
}

/* Makes the factor one of positive pivots, which is faster, or of any. */
static sfem_status sfemi_lanczos_signs(sfemi_lanczos *z, int positive, sfem_error *err)
{
    const sfem_allocator *al = z->s->al;
    sfem_ldl *ldl = z->ldl;
    sfem_status status = SFEM_OK;
    ldl->positive = 1;
    if (positive) return SFEM_OK;
    if (!ldl->signs) SFEMI_NEW(double, ldl->signs, al, ldl->symbolic->signs[ldl->symbolic->tasks] + 1);
    if (!ldl->probe) SFEMI_NEW(double, ldl->probe, al, 2 * z->rows + sfem_ldl_work_size(ldl, 1));
    ldl->positive = 0;
done:
    return status;
}

/* A = K - shift M, and its factor. */
static sfem_status sfemi_lanczos_factor(sfemi_lanczos *z, sfem_real shift, int positive, sfem_error *err)
{
    const sfemi_modes_system *s = z->s;
    sfem_status status = SFEM_OK;
    sfem_real *x = NULL;
    sfem_int i, at;
    int c;
    memcpy(z->a.val, s->k.val, 9 * (size_t)s->k.row[s->n] * sizeof *z->a.val);
    for (i = 0; i < s->n; ++i)
        for (at = s->k.row[i]; at < s->k.row[i + 1]; ++at)
            for (c = 0; c < 3; ++c) {
                const sfem_real m = s->scalar ? s->scalar[at] : at + 1 == s->k.row[i + 1] ? s->mass[3 * i + c] : 0;
                if (s->mass[3 * (size_t)i + (size_t)c] == 0 ||
                    s->mass[3 * (size_t)s->k.col[at] + (size_t)c] == 0)
                    continue;
                z->a.val[9 * (size_t)at + (size_t)(4 * c)] -= shift * m;
            }
    ++z->info->factorisations;
    if (z->ldl) {
        SFEMI_TRY(sfemi_lanczos_signs(z, positive, err));
        return sfem_ldl_refactor(z->ldl, &z->a, err);
    }
    SFEMI_NEW(sfem_real, x, s->al, 3 * (size_t)s->n);
    for (i = 0; i < s->n; ++i)
        memcpy(x + 3 * (size_t)i, s->model->mesh.x + 3 * (size_t)s->node[i], 3 * sizeof *x);
    {
        sfem_ldl_def def = sfem_default_ldl_def();
        def.ordering = s->def->ordering;
        def.positive = positive;
        def.allocator = *s->al;
        def.exec = s->def->exec;
        def.x = x;
        status = sfem_ldl_create(&def, &z->a, &z->ldl, err);
    }
done:
    sfemi_delete(s->al, x);
    return status;
}

/* Lowest eigenvalue of a free body, roughly, from above: Rayleigh's quotient of bending and stretching
 * fields along the principal axes of each piece, the least of all pieces. */
static sfem_status sfemi_modes_estimate(const sfemi_modes_system *s, sfem_real *out, sfem_error *err)
{
    const size_t rows = 3 * (size_t)s->n;
    sfem_real *moment = NULL, *x = NULL, *y = NULL, *sums = NULL, value[3], work[15];
    sfem_status status = SFEM_OK;
    sfem_int i, p;
    size_t r;
    int a, c, q;
    SFEMI_NEW(sfem_real, moment, s->al, 13 * (size_t)s->pieces); /* mass, centre, second moments */
    SFEMI_NEW(sfem_real, sums, s->al, 8 * (size_t)s->pieces);
    SFEMI_NEW(sfem_real, x, s->al, 4 * rows);
    SFEMI_NEW(sfem_real, y, s->al, 4 * rows);
    for (i = 0; i < s->n; ++i) {
        sfem_real *m = moment + 13 * s->piece[i];
        const sfem_real mass = s->model->node_mass[s->node[i]];
        *m += mass;
        for (c = 0; c < 3; ++c) m[1 + c] += mass * s->model->mesh.x[3 * (size_t)s->node[i] + (size_t)c];
    }
    for (p = 0; p < s->pieces; ++p)
        for (c = 0; c < 3; ++c) moment[13 * p + 1 + c] /= moment[13 * p];
    for (i = 0; i < s->n; ++i) {
        sfem_real *m = moment + 13 * s->piece[i], d[3];
        sfemi_sub3(s->model->mesh.x + 3 * (size_t)s->node[i], m + 1, d);
        for (c = 0; c < 9; ++c) m[4 + c] += s->model->node_mass[s->node[i]] * d[c / 3] * d[c % 3];
    }
    for (p = 0; p < s->pieces; ++p)
        SFEMI_TRY(sfem_dense_eigen(3, moment + 13 * p + 4, NULL, value, work, err));
    for (i = 0; i < s->n; ++i) { /* axes ascend: 2 is the longest; field a, c bends axis a toward c */
        static const int bent[3] = {2, 2, 1}, toward[3] = {0, 1, 0};
        const sfem_real *w = moment + 13 * s->piece[i];
        sfem_real d[3], l[3];
        sfemi_sub3(s->model->mesh.x + 3 * (size_t)s->node[i], w + 1, d);
        for (a = 0; a < 3; ++a) l[a] = sfemi_dot3(d, w + 4 + 3 * a);
        for (c = 0; c < 3; ++c) {
            const size_t at = 3 * (size_t)i + (size_t)c;
            if (s->mass[at] == 0) continue;
            for (q = 0; q < 3; ++q)
                x[4 * at + (size_t)q] = l[bent[q]] * l[bent[q]] / 2 * w[4 + 3 * toward[q] + c] -
                                        l[bent[q]] * l[toward[q]] * w[4 + 3 * bent[q] + c];
            x[4 * at + 3] = l[2] * w[10 + c];
        }
    }
    sfemi_modes_deflate(s, x);
    for (c = 0; c < 2; ++c) {
        if (c == 0) sfemi_modes_stiffness(s, x, y);
        else sfemi_modes_mass(s, x, y);
        for (r = 0; r < rows; ++r)
            for (q = 0; q < 4; ++q)
                sums[8 * s->piece[r / 3] + 4 * c + q] += x[4 * r + (size_t)q] * y[4 * r + (size_t)q];
    }
    *out = HUGE_VAL;
    for (p = 0; p < s->pieces; ++p)
        for (q = 0; q < 4; ++q)
            if (sums[8 * p + 4 + q] > 0) *out = fmin(*out, sums[8 * p + q] / sums[8 * p + 4 + q]);
done:
    sfemi_delete(s->al, moment);
    sfemi_delete(s->al, sums);
    sfemi_delete(s->al, x);
    sfemi_delete(s->al, y);
    return status;
}

/* The factor of K - sigma M, sigma = 0 if the body is held and digits suffice, else below 0 by about a
 * fourth of the lowest elastic eigenvalue, and by enough for K + |sigma| M to be positive in rounding. */
static sfem_status sfemi_lanczos_shift(sfemi_lanczos *z, sfem_error *err)
{
    const sfemi_modes_system *s = z->s;
    sfem_real low = 0, top = 0;
    sfem_status status;
    sfem_int i;
    int c, attempt;
    z->sigma = 0;
    if (s->rigid == 0) {
        status = sfemi_lanczos_factor(z, 0, 1, err);
        if (status == SFEM_OK || status == SFEM_OUT_OF_MEMORY || status == SFEM_TOO_LARGE) return status;
    }
    status = sfemi_modes_estimate(s, &low, err);
    if (status != SFEM_OK) return status;
    for (i = 0; i < s->n; ++i)
        for (c = 0; c < 3; ++c)
            if (s->mass[3 * i + c] > 0)
                top = fmax(top, s->k.val[9 * ((size_t)s->k.row[i + 1] - 1) + (size_t)(4 * c)] /
                                    s->mass[3 * i + c]);
    z->sigma = -fmin(fmax(low / 4, 1e-13 * top), top);
    for (attempt = 0; attempt < 3; ++attempt, z->sigma *= 30) {
        status = sfemi_lanczos_factor(z, z->sigma, 1, err);
        if (status == SFEM_OK || status == SFEM_OUT_OF_MEMORY || status == SFEM_TOO_LARGE) return status;
    }
    return sfemi_fail(err, SFEM_NOT_SPD,
                      "K + %g M is not positive definite: a tet without stiffness, or no digits left",
                      -z->sigma / 30);
}

static sfem_status sfemi_lanczos_create(sfemi_modes_system *s, sfem_modes_info *info,
                                        sfemi_lanczos *z, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    memset(z, 0, sizeof *z);
    z->s = s;
    z->f = sfemi_modes_kernels_of(sfemi_path());
    z->exec = &s->def->exec;
    z->info = info;
    z->rows = 3 * (size_t)s->n;
    z->padded = (z->rows + 23) / 24 * 24;
    z->chunks = (sfem_int)((z->padded + SFEMI_MODES_CHUNK - 1) / SFEMI_MODES_CHUNK);
    z->random = 0x9e3779b97f4a7c15u ^ s->def->seed;
    z->a = s->k;
    z->a.val = NULL;
    SFEMI_NEW(sfem_real, z->a.val, s->al, 9 * (size_t)s->k.row[s->n]);
done:
    return status;
}

static sfem_int sfemi_lanczos_capacity(const sfem_modes_def *def, sfem_int wanted)
{
    const sfem_int least = wanted + 32;
    const sfem_int many = 3 * wanted + 100, more = wanted + wanted / 2 + 250;
    const sfem_int capacity = def->max_basis ? def->max_basis : many < more ? many : more;
    return ((capacity < least ? least : capacity) + 7) / 8 * 8;
}

static sfem_status sfemi_lanczos_reserve(sfemi_lanczos *z, sfem_int wanted, sfem_error *err)
{
    const sfem_allocator *al = z->s->al;
    const size_t h = (size_t)sfemi_lanczos_capacity(z->s->def, wanted);
    sfem_status status = SFEM_OK;
    size_t i;
    z->wanted = wanted;
    z->capacity = (sfem_int)h;
    z->panels = (sfem_int)((h + 23) / 24);
    SFEMI_NEW(sfem_real, z->v, al, (size_t)z->panels * 24 * z->padded);
    SFEMI_NEW(sfem_real, z->w, al, 4 * z->padded + 16);
    z->mw = z->w;
    if (z->s->scalar) SFEMI_NEW(sfem_real, z->mw, al, 4 * z->padded + 16);
    SFEMI_NEW(sfem_real, z->work, al, sfem_ldl_work_size(z->ldl, 8));
    SFEMI_NEW(sfem_real, z->c, al, 96 * (size_t)z->panels);
    SFEMI_NEW(sfem_real, z->part, al, 96 * (size_t)z->panels * (size_t)z->chunks);
    SFEMI_NEW(sfem_real, z->t, al, h * h);
    SFEMI_NEW(sfem_real, z->ritz, al, h * h);
    SFEMI_NEW(sfem_real, z->theta, al, h);
    SFEMI_NEW(sfem_real, z->rho, al, h);
    SFEMI_NEW(sfem_real, z->small, al, 14 * h);
    SFEMI_NEW(sfem_real, z->ax, al, 12 * z->padded);
    if (z->s->root && z->s->rigid) {
        SFEMI_NEW(sfem_real, z->s->half, al, 6 * z->rows);
        for (i = 0; i < 6 * z->rows; ++i) z->s->half[i] = z->s->root[i % z->rows] * z->s->z[i];
    }
done:
    return status;
}

/* Ritz values below the bound. By the minimax principle no more than eigenvalues there. */
static sfem_int sfemi_lanczos_below(const sfemi_lanczos *z, sfem_real bound)
{
    sfem_int i = 0;
    while (i < z->m && sfemi_lanczos_lambda(z, z->theta[i]) < bound) ++i;
    return i;
}

/* How many eigenvalues lie below the bound: SFEM_SINGULAR where that cannot be told. */
static sfem_status sfemi_lanczos_count(sfemi_lanczos *z, sfem_real bound, sfem_error *err)
{
    const sfem_status status = sfemi_lanczos_factor(z, bound, 0, err);
    if (status != SFEM_OK) return status;
    z->info->below = sfem_ldl_get_info(z->ldl).negative;
    z->info->bound = bound;
    return SFEM_OK;
}

/* Counts in the gap above what is wanted: info->proved if nothing is missing; info->below stays -1 if
 * there is no gap yet. */
static sfem_status sfemi_lanczos_prove(sfemi_lanczos *z, sfem_error *err)
{
    sfem_real bound = 0;
    sfem_status status = SFEM_OK;
    sfem_int end = 0;
    int attempt;
    for (attempt = 0; attempt < 5; ++attempt) {
        if (!sfemi_lanczos_gap(z, attempt, &bound, &end)) return SFEM_OK;
        status = sfemi_lanczos_count(z, bound, err);
        if (status != SFEM_OK && status != SFEM_SINGULAR) return status;
        if (status == SFEM_OK && z->info->below >= z->s->rigid + end) break;
    }
    if (attempt == 5)
        return sfemi_fail(err, SFEM_SINGULAR, "eigenvalues below %g 1/s^2 cannot be counted: digits run out",
                          bound);
    z->info->proved = z->info->below == z->s->rigid + end;
    return SFEM_OK;
}

/* Makes the restart that something is missing for: all that has converged is kept, then chance. */
static sfem_status sfemi_lanczos_search(sfemi_lanczos *z, int refactor, sfem_error *err)
{
    sfem_status status = refactor ? sfemi_lanczos_factor(z, z->sigma, 1, err) : SFEM_OK;
    sfem_int keep = 0;
    if (status != SFEM_OK) return status;
    while (keep < z->m && keep < z->capacity - 24 && z->gain * z->rho[keep] <= z->s->def->tolerance * z->theta[keep])
        ++keep;
    status = sfemi_lanczos_restart(z, keep, err);
    if (status == SFEM_OK) sfemi_lanczos_begin(z);
    return status;
}

/* When to look at the Ritz values next, by the rate at which the worst of the wanted ones falls: a look
 * costs as much as many steps on a small body. */
static sfem_int sfemi_lanczos_next(const sfemi_lanczos *z, sfem_int before, sfem_real was, sfem_real worst)
{
    const sfem_real tol = z->s->def->tolerance;
    sfem_real columns = 16;
    if (worst < 1 && was < HUGE_VAL && was > worst && z->m > before)
        columns = 0.9 * (z->m - before) * log(worst / tol) / log(was / worst);
    else if (worst < 1)
        columns = 1.1 * sqrt((sfem_real)z->wanted) * log10(worst / tol);
    columns = fmin(fmax(columns, 1.0), 64.0);
    return z->m + ((sfem_int)columns + 3) / 4 * 4;
}

/* Steps and restarts until the wanted ones have converged and nothing is missing below the bound. */
static sfem_status sfemi_lanczos_iterate(sfemi_lanczos *z, sfem_error *err)
{
    const sfem_modes_def *def = z->s->def;
    const sfem_int restarts = def->max_restarts ? def->max_restarts : 40;
    sfem_int next = z->wanted + z->wanted * 4 / 5 + 40, before = 0;
    sfem_real worst = HUGE_VAL, was;
    sfem_status status = SFEM_OK;
    int searching = 0;
    sfemi_lanczos_begin(z);
    for (;;) {
        int full;
        sfemi_lanczos_step(z);
        full = z->m + 4 > z->capacity;
        if (full || z->m >= next) {
            /* the first look is a cheap one; where the rate is known, this may be the last */
            if (!(worst < HUGE_VAL || full ? sfemi_lanczos_vectors(z) : sfemi_lanczos_values(z)))
                return sfemi_fail(err, SFEM_NOT_CONVERGED,
                                  "an eigenvalue of the Lanczos matrix does not converge");
            was = worst;
            worst = sfemi_lanczos_worst(z, z->wanted);
            next = sfemi_lanczos_next(z, before, was, worst);
            before = z->m;
            if (worst <= def->tolerance) {
                const int counted = z->info->below >= 0;
                if (!counted && def->no_proof) return SFEM_OK;
                if (!counted) status = sfemi_lanczos_prove(z, err);
                else z->info->proved = sfemi_lanczos_below(z, z->info->bound) + z->s->rigid == z->info->below;
                if (status != SFEM_OK || z->info->proved) return status;
                if (z->info->below >= 0 && (!searching || full)) {
                    if (z->info->restarts >= restarts) break;
                    z->info->recovered =
                        z->info->below - z->s->rigid - sfemi_lanczos_below(z, z->info->bound);
                    status = sfemi_lanczos_search(z, !counted, err);
                    if (status != SFEM_OK) return status;
                    searching = 1;
                    worst = HUGE_VAL;
                    next = z->m + 32;
                    continue;
                }
                next = z->m + 8;
            }
        }
        if (full) {
            if (z->info->restarts >= restarts) break;
            status = sfemi_lanczos_restart(z, z->wanted + (z->m - z->wanted) / 3, err);
            if (status != SFEM_OK) return status;
            worst = HUGE_VAL;
            next = z->m + 16;
        }
        sfemi_lanczos_append(z);
    }
    if (worst <= def->tolerance)
        return sfemi_fail(err, SFEM_SINGULAR,
                          "%d eigenvalues are counted below %g 1/s^2, of which only %d are found after %d "
                          "restarts", (int)z->info->below, z->info->bound,
                          (int)(sfemi_lanczos_below(z, z->info->bound) + z->s->rigid), (int)restarts);
    return sfemi_fail(err, SFEM_NOT_CONVERGED,
                      "after %d restarts the worst of %d modes is still off by %g: more max_restarts, or a "
                      "larger max_basis", (int)restarts, (int)z->wanted, worst);
}

/* W to modes k ... k + 3 of the result, as displacements. */
static void sfemi_lanczos_write(const sfemi_lanczos *z, sfem_int k, sfem_modes *out)
{
    const sfemi_modes_system *s = z->s;
    sfem_int i, q;
    size_t c;
    for (q = 0; q < 4 && k + q < z->wanted; ++q) {
        sfem_real *phi = out->phi + (size_t)(out->rigid + k + q) * 3 * (size_t)out->nodes;
        for (i = 0; i < s->n; ++i)
            for (c = 0; c < 3; ++c) {
                const size_t at = 3 * (size_t)i + c;
                if (s->mass[at] > 0)
                    phi[3 * (size_t)s->node[i] + c] =
                        z->w[4 * at + (size_t)q] / (s->root ? s->root[at] : 1);
            }
    }
}

/* The first of the eigenvectors in ritz as modes. */
static void sfemi_lanczos_output(sfemi_lanczos *z, sfem_modes *out)
{
    sfemi_lanczos_job job;
    sfem_int k;
    job.z = z;
    job.first = 0;
    job.panels = (z->m + 23) / 24;
    job.minus = 0;
    job.c = z->c;
    job.w = z->w;
    job.kept = 0;
    for (k = 0; k < z->wanted; k += 4) {
        sfemi_lanczos_pick(z, k, z->wanted, z->c);
        memset(z->w, 0, 4 * z->padded * sizeof *z->w);
        sfemi_run(z->exec, z->chunks, sfemi_lanczos_combine_chunk, &job);
        sfemi_lanczos_write(z, k, out);
    }
}

/* y = K x, x the four columns of V from k on, as displacements. */
static void sfemi_lanczos_product(const sfemi_lanczos *z, sfem_int k, sfem_real *x, sfem_real *y)
{
    const sfem_real *root = z->s->root;
    sfem_int q;
    size_t r;
    memset(x, 0, 4 * z->padded * sizeof *x);
    for (q = 0; q < 4 && k + q < z->m; ++q) {
        const sfem_real *from = z->v + (size_t)((k + q) / 24) * 24 * z->padded + (size_t)((k + q) % 24);
        for (r = 0; r < z->rows; ++r)
            x[4 * r + (size_t)q] = from[24 * r] / (root && root[r] > 0 ? root[r] : 1);
    }
    sfemi_modes_stiffness(z->s, x, y);
}

/* A step of inverse iteration, phi -= (K - sigma M)^-1 (K - lambda M) phi, for each vector of V; then
 * orthonormal again. (With tau's factor the modes above would grow.) */
static void sfemi_lanczos_polish(sfemi_lanczos *z)
{
    const sfemi_modes_system *s = z->s;
    const sfem_int m = z->m;
    sfem_real *x = z->ax, *y = x + 4 * z->padded, *mx = y + 4 * z->padded;
    sfem_int k, q;
    size_t r;
    for (k = 0; k < m; k += 4) {
        const sfem_int some = m - k < 4 ? m - k : 4;
        z->m = m;
        sfemi_lanczos_product(z, k, x, y);
        sfemi_modes_mass(s, x, mx);
        for (r = 0; r < z->rows; ++r)
            for (q = 0; q < some; ++q)
                y[4 * r + (size_t)q] -=
                    sfemi_lanczos_lambda(z, z->theta[k + q]) * mx[4 * r + (size_t)q];
        memcpy(mx, x, 4 * z->rows * sizeof *x);
        sfemi_lanczos_solve(z, NULL, y, x);
        memset(z->w, 0, 4 * z->padded * sizeof *z->w);
        for (r = 0; r < z->rows; ++r)
            for (q = 0; q < some && s->mass[r] > 0; ++q)
                z->w[4 * r + (size_t)q] =
                    (mx[4 * r + (size_t)q] - x[4 * r + (size_t)q]) * (s->root ? s->root[r] : 1);
        z->m = k;
        for (q = 0; q < 2; ++q) {
            sfemi_modes_deflate(s, z->w);
            sfemi_lanczos_orthogonalise(z, 0, -1);
        }
        sfemi_lanczos_normalise(z, 0);
        sfemi_lanczos_put(z, k, some, z->w);
    }
    z->m = m;
}

/* T is the inverse's: its rounding errors are of the size of the largest theta, and turn modes far above
 * the first among themselves, and the first steps leave noise, with residuals of up to lambda_k / lambda_1
 * rounding errors. Where that shows, the first Ritz vectors are polished, and Rayleigh and Ritz work once
 * more, with K itself. */
static sfem_status sfemi_lanczos_rayleigh(sfemi_lanczos *z, sfem_modes *out, sfem_error *err)
{
    const sfemi_modes_system *s = z->s;
    const sfem_real *root = s->root;
    const sfem_int most = (z->wanted + z->wanted / 4 + 16) / 4 * 4, restarts = z->info->restarts;
    sfem_real *x = z->ax, *y = x + 4 * z->padded;
    sfem_status status = sfemi_lanczos_restart(z, most < z->m ? most : z->m / 4 * 4, err);
    sfemi_lanczos_job job;
    sfem_int k, i, q;
    size_t r;
    if (status != SFEM_OK) return status;
    z->info->restarts = restarts;
    sfemi_lanczos_polish(z);
    job.z = z;
    job.first = 0;
    job.panels = (z->m + 23) / 24;
    for (k = 0; k < z->m; k += 4) {
        sfemi_lanczos_product(z, k, x, y);
        memset(z->mw, 0, 4 * z->padded * sizeof *z->mw);
        for (r = 0; r < z->rows; ++r)
            for (q = 0; q < 4; ++q)
                z->mw[4 * r + (size_t)q] = s->mass[r] > 0 ? y[4 * r + (size_t)q] / (root ? root[r] : 1) : 0;
        sfemi_lanczos_dots(z, &job);
        for (q = 0; q < 4 && k + q < z->m; ++q)
            for (i = 0; i < z->m; ++i)
                z->t[(size_t)i + (size_t)(k + q) * (size_t)z->capacity] = -z->c[4 * i + q];
    }
    if (!sfemi_lanczos_vectors(z))
        return sfemi_fail(err, SFEM_NOT_CONVERGED, "an eigenvalue of the Lanczos matrix does not converge");
    for (k = 0; k < z->wanted; ++k) out->lambda[out->rigid + k] = -z->theta[k];
    for (k = 0; k < z->m; ++k) z->theta[k] = 1 / (-z->theta[k] - z->sigma);
    sfemi_lanczos_output(z, out);
    return sfemi_modes_errors(s, out, err);
}

/* The wanted Ritz vectors, as displacements. */
static sfem_status sfemi_lanczos_result(sfemi_lanczos *z, sfem_modes *out, sfem_error *err)
{
    const sfemi_modes_system *s = z->s;
    sfem_status status = sfemi_modes_result(s, z->wanted, out, err);
    sfem_real *lambda = NULL, worst;
    sfem_int i;
    int turn;
    if (status != SFEM_OK) return status;
    if (!sfemi_lanczos_vectors(z))
        return sfemi_fail(err, SFEM_NOT_CONVERGED, "an eigenvalue of the Lanczos matrix does not converge");
    SFEMI_NEW(sfem_real, lambda, s->al, z->m);
    for (i = 0; i < z->m; ++i) lambda[i] = sfemi_lanczos_lambda(z, z->theta[i]);
    memcpy(out->lambda + out->rigid, lambda, (size_t)z->wanted * sizeof *lambda);
    out->info.cut = sfemi_modes_cut(lambda, z->wanted, z->m);
    out->info.converged = z->wanted;
    out->info.sigma = z->sigma;
    sfemi_lanczos_output(z, out);
    SFEMI_TRY(sfemi_modes_errors(s, out, err));
    for (turn = 0; turn < 3; ++turn) {
        for (worst = 0, i = 0; i < out->count; ++i) worst = fmax(worst, out->error[i]);
        if (worst <= 0.7 * s->def->tolerance) break;
        if (turn == 0 && z->info->below >= 0) SFEMI_TRY(sfemi_lanczos_factor(z, z->sigma, 1, err));
        SFEMI_TRY(sfemi_lanczos_rayleigh(z, out, err));
    }
done:
    sfemi_delete(s->al, lambda);
    return status;
}

/* How many lie below the frequency asked for; a count that hits an eigenvalue is moved up a little. */
static sfem_status sfemi_lanczos_census(sfemi_lanczos *z, sfem_int *wanted, sfem_error *err)
{
    const sfem_real omega = z->s->def->below_hz * 6.283185307179586;
    sfem_status status = SFEM_OK;
    int attempt;
    for (attempt = 0; attempt < 4; ++attempt) {
        status = sfemi_lanczos_count(z, omega * omega * (1 + attempt * 3e-9), err);
        if (status != SFEM_SINGULAR) break;
    }
    *wanted = z->info->below - z->s->rigid;
    return status;
}

static sfem_status sfemi_modes_lanczos(sfemi_modes_system *s, sfem_modes *out, int *too_few,
                                       sfem_error *err)
{
    sfem_int wanted = s->def->modes;
    sfem_status status;
    sfemi_lanczos z;
    out->info.below = out->info.cut = -1;
    SFEMI_TRY(sfemi_lanczos_create(s, &out->info, &z, err));
    if (s->def->below_hz > 0) SFEMI_TRY(sfemi_lanczos_census(&z, &wanted, err));
    *too_few = sfemi_lanczos_capacity(s->def, wanted) + 16 > s->axes - s->rigid;
    if (*too_few) goto done;
    if (wanted > 0) {
        SFEMI_TRY(sfemi_lanczos_shift(&z, err));
        SFEMI_TRY(sfemi_lanczos_reserve(&z, wanted, err));
        SFEMI_TRY(sfemi_lanczos_iterate(&z, err));
        SFEMI_TRY(sfemi_lanczos_result(&z, out, err));
    } else {
        SFEMI_TRY(sfemi_modes_result(s, 0, out, err));
        SFEMI_TRY(sfemi_modes_errors(s, out, err));
        out->info.proved = s->def->below_hz > 0;
        out->info.cut = -1;
    }
done:
    sfemi_lanczos_free(&z);
    return status;
}

/* --- the whole ------------------------------------------------------------------------------- */

SFEM_DEF sfem_modes_def sfem_default_modes_def(void)
{
    sfem_modes_def def;
    memset(&def, 0, sizeof def);
    def.modes = 20;
    def.tolerance = 1e-13;
    return def;
}

static sfem_status sfemi_modes_check(const sfem_modes_def *def, sfem_error *err)
{
    if (!sfemi_finite(def->below_hz) || def->below_hz < 0)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "below_hz is %g, must be 0 or a frequency",
                          def->below_hz);
    if (def->modes < 0)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "modes is %d, must be >= 0", (int)def->modes);
    if (!(def->tolerance >= 1e-15 && def->tolerance <= 1e-2))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "tolerance is %g, must be 1e-15 to 1e-2",
                          def->tolerance);
    if (def->max_basis < 0 || def->max_restarts < 0)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "max_basis %d or max_restarts %d is negative",
                          (int)def->max_basis, (int)def->max_restarts);
    return SFEM_OK;
}

SFEM_DEF sfem_status sfem_modes_create(sfem_model *model, const sfem_modes_def *def, sfem_modes *out,
                                       sfem_error *err)
{
    sfemi_modes_system s;
    sfem_modes result;
    sfem_status status;
    int dense;
    SFEM_ASSERT(model && def && out);
    memset(&result, 0, sizeof result);
    memset(&s, 0, sizeof s);
    dense = def->dense;
    s.al = &def->allocator;
    result.allocator = def->allocator;
    SFEMI_TRY(sfemi_modes_check(def, err));
    SFEMI_TRY(sfemi_modes_system_create(model, def, &s, err));
    if (def->below_hz == 0 && def->modes > s.axes - s.rigid) {
        status = sfemi_modes_too_many(&s, err);
        goto done;
    }
    if (!dense) SFEMI_TRY(sfemi_modes_lanczos(&s, &result, &dense, err));
    if (dense) SFEMI_TRY(sfemi_modes_dense(&s, &result, err));
    *out = result;
done:
    sfemi_modes_system_free(&s);
    if (status != SFEM_OK) sfem_modes_free(&result);
    return status;
}

SFEM_DEF void sfem_modes_free(sfem_modes *modes)
{
    if (!modes) return;
    sfemi_delete(&modes->allocator, modes->lambda);
    sfemi_delete(&modes->allocator, modes->phi);
    sfemi_delete(&modes->allocator, modes->error);
    memset(modes, 0, sizeof *modes);
}

SFEM_DEF sfem_real sfem_modes_hz(const sfem_modes *modes, sfem_int k)
{
    SFEM_ASSERT(modes && k >= 0 && k < modes->count);
    return sqrt(fmax(modes->lambda[k], 0.0)) / 6.283185307179586;
}

/* ============================================================================================
 * >>reduced   modal bodies: oscillators, warping, handles
 * ============================================================================================ */

/* ============================================================================================
 * >>link   packets of accelerations, key frames
 * ============================================================================================ */

#ifdef __cplusplus
}
#endif
#endif /* SOFTFEM_IMPLEMENTATION */

/* ============================================================================================
 * >>kernels   the inner loops, compiled once for each vector path and precision
 *
 * This part is not guarded: the implementation includes the file again with SFEMI_PATH and
 * SFEMI_BITS defined, and nothing but this part is then read.
 * ============================================================================================ */
#ifdef SFEMI_PATH

/* --- vectors ---------------------------------------------------------------------------------
 * Doubles are 4 wide, on AVX-512 8; floats 8 wide on every path. */
#if SFEMI_PATH == 2 && !defined(SFEMI_EMULATE_AVX512) /* a test's, for processors without it */
#define SFEMI_TARGET __attribute__((target("avx512f,avx2,fma")))
#elif SFEMI_PATH >= 1
#define SFEMI_TARGET __attribute__((target("avx2,fma")))
#else
#define SFEMI_TARGET
#endif

#if SFEMI_BITS == 64
#define SFEMI_R double
#if SFEMI_PATH == 2
#define SFEMI_W 8
#else
#define SFEMI_W 4
#endif
#else
#define SFEMI_R float
#define SFEMI_W 8
#endif

#define SFEMI_PASTE3(a, b, c) a##_##b##_##c
#define SFEMI_PASTE(a, b, c)  SFEMI_PASTE3(a, b, c)
#define SFEMI_KERNEL(name)    SFEMI_PASTE(name, SFEMI_BITS, SFEMI_PATH)

#if SFEMI_PATH == 2 && SFEMI_BITS == 64 && !defined(SFEMI_EMULATE_AVX512)
#define SFEMI_V             __m512d
#define SFEMI_LD(p)         _mm512_loadu_pd(p)
#define SFEMI_ST(p, v)      _mm512_storeu_pd(p, v)
#define SFEMI_DUP(s)        _mm512_set1_pd(s)
#define SFEMI_ADD(a, b)     _mm512_add_pd(a, b)
#define SFEMI_MUL(a, b)     _mm512_mul_pd(a, b)
#define SFEMI_FMA(a, b, c)  _mm512_fmadd_pd(a, b, c)
#define SFEMI_FNMA(a, b, c) _mm512_fnmadd_pd(a, b, c)
#define SFEMI_HALF(p)       _mm256_add_pd(_mm256_loadu_pd(p), _mm256_loadu_pd((p) + 4))
#elif SFEMI_PATH >= 1 && SFEMI_BITS == 64 && SFEMI_W == 4
#define SFEMI_V             __m256d
#define SFEMI_LD(p)         _mm256_loadu_pd(p)
#define SFEMI_ST(p, v)      _mm256_storeu_pd(p, v)
#define SFEMI_DUP(s)        _mm256_set1_pd(s)
#define SFEMI_ADD(a, b)     _mm256_add_pd(a, b)
#define SFEMI_MUL(a, b)     _mm256_mul_pd(a, b)
#define SFEMI_FMA(a, b, c)  _mm256_fmadd_pd(a, b, c)
#define SFEMI_FNMA(a, b, c) _mm256_fnmadd_pd(a, b, c)
#define SFEMI_HALF(p)       _mm256_loadu_pd(p)
#elif SFEMI_PATH >= 1 && SFEMI_BITS == 32
#define SFEMI_V             __m256
#define SFEMI_LD(p)         _mm256_loadu_ps(p)
#define SFEMI_ST(p, v)      _mm256_storeu_ps(p, v)
#define SFEMI_DUP(s)        _mm256_set1_ps(s)
#define SFEMI_ADD(a, b)     _mm256_add_ps(a, b)
#define SFEMI_MUL(a, b)     _mm256_mul_ps(a, b)
#define SFEMI_FMA(a, b, c)  _mm256_fmadd_ps(a, b, c)
#define SFEMI_FNMA(a, b, c) _mm256_fnmadd_ps(a, b, c)
#define SFEMI_SUM4(z, out)                                                                         \
    {                                                                                              \
        const __m256 a_ = _mm256_hadd_ps(_mm256_loadu_ps(z), _mm256_loadu_ps((z) + 8));            \
        const __m256 b_ = _mm256_hadd_ps(_mm256_loadu_ps((z) + 16), _mm256_loadu_ps((z) + 24));    \
        const __m256 c_ = _mm256_hadd_ps(a_, b_);                                                  \
        _mm_storeu_ps(out, _mm_add_ps(_mm256_castps256_ps128(c_), _mm256_extractf128_ps(c_, 1)));  \
    }
#elif defined(__GNUC__) && SFEMI_W * SFEMI_BITS == 256 /* two vectors of 16 bytes: SSE2, NEON */
typedef SFEMI_R SFEMI_KERNEL(sfemi_h) __attribute__((vector_size(16)));
typedef SFEMI_R SFEMI_KERNEL(sfemi_u) __attribute__((vector_size(16), aligned(4), may_alias));
typedef struct SFEMI_KERNEL(sfemi_v) {
    SFEMI_KERNEL(sfemi_h) a, b;
} SFEMI_KERNEL(sfemi_v);
#define SFEMI_V SFEMI_KERNEL(sfemi_v)
#define SFEMI_H SFEMI_KERNEL(sfemi_h)
/* a processor with multiply-add always uses it here, lest the compiler choose */
#if defined(__FMA__) && SFEMI_BITS == 64
#define SFEMI_FMAH(x, y, z) (SFEMI_H) _mm_fmadd_pd(x, y, z)
#elif defined(__FMA__)
#define SFEMI_FMAH(x, y, z) (SFEMI_H) _mm_fmadd_ps(x, y, z)
#elif defined(__aarch64__) && SFEMI_BITS == 64
#define SFEMI_FMAH(x, y, z) (SFEMI_H) vfmaq_f64(z, x, y)
#elif defined(__aarch64__)
#define SFEMI_FMAH(x, y, z) (SFEMI_H) vfmaq_f32(z, x, y)
#else
#define SFEMI_FMAH(x, y, z) ((x) * (y) + (z))
#endif
#define SFEMI_PAIR(name, arguments, first, second)                                                 \
    static SFEMI_INLINE SFEMI_V SFEMI_KERNEL(name) arguments                                       \
    {                                                                                              \
        SFEMI_V r;                                                                                 \
        r.a = first;                                                                               \
        r.b = second;                                                                              \
        return r;                                                                                  \
    }
SFEMI_PAIR(sfemi_v_load, (const SFEMI_R *p), *(const SFEMI_KERNEL(sfemi_u) *)(const void *)p,
           *(const SFEMI_KERNEL(sfemi_u) *)(const void *)(p + SFEMI_W / 2))
static SFEMI_INLINE SFEMI_V SFEMI_KERNEL(sfemi_v_dup)(SFEMI_R s)
{
#if SFEMI_BITS == 64
    const SFEMI_H h = {s, s};
#else
    const SFEMI_H h = {s, s, s, s};
#endif
    SFEMI_V r;
    r.a = r.b = h;
    return r;
}
SFEMI_PAIR(sfemi_v_add, (SFEMI_V x, SFEMI_V y), x.a + y.a, x.b + y.b)
SFEMI_PAIR(sfemi_v_mul, (SFEMI_V x, SFEMI_V y), x.a *y.a, x.b *y.b)
SFEMI_PAIR(sfemi_v_fma, (SFEMI_V x, SFEMI_V y, SFEMI_V z), SFEMI_FMAH(x.a, y.a, z.a),
           SFEMI_FMAH(x.b, y.b, z.b))
SFEMI_PAIR(sfemi_v_fnma, (SFEMI_V x, SFEMI_V y, SFEMI_V z), SFEMI_FMAH(-x.a, y.a, z.a),
           SFEMI_FMAH(-x.b, y.b, z.b))
static SFEMI_INLINE void SFEMI_KERNEL(sfemi_v_store)(SFEMI_R *p, SFEMI_V v)
{
    *(SFEMI_KERNEL(sfemi_u) *)(void *)p = v.a;
    *(SFEMI_KERNEL(sfemi_u) *)(void *)(p + SFEMI_W / 2) = v.b;
}
#undef SFEMI_PAIR
#undef SFEMI_FMAH
#undef SFEMI_H
#else /* plain C; a processor with multiply-add always uses it, lest the compiler choose */
typedef struct SFEMI_KERNEL(sfemi_v) {
    SFEMI_R e[SFEMI_W];
} SFEMI_KERNEL(sfemi_v);
#define SFEMI_V SFEMI_KERNEL(sfemi_v)
#ifdef FP_FAST_FMA
#define SFEMI_FMA1(a, b, c)                                                                        \
    ((SFEMI_R)(sizeof(SFEMI_R) == 8 ? fma(a, b, c) : fmaf((float)(a), (float)(b), (float)(c))))
#else
#define SFEMI_FMA1(a, b, c) ((a) * (b) + (c))
#endif
#define SFEMI_BY_LANE(name, arguments, expression)                                                   \
    static SFEMI_INLINE SFEMI_V SFEMI_KERNEL(name) arguments                                       \
    {                                                                                              \
        SFEMI_V r;                                                                                 \
        int i;                                                                                     \
        for (i = 0; i < SFEMI_W; ++i) r.e[i] = (expression);                                       \
        return r;                                                                                  \
    }
SFEMI_BY_LANE(sfemi_v_load, (const SFEMI_R *p), p[i])
SFEMI_BY_LANE(sfemi_v_dup, (SFEMI_R s), s)
SFEMI_BY_LANE(sfemi_v_add, (SFEMI_V a, SFEMI_V b), a.e[i] + b.e[i])
SFEMI_BY_LANE(sfemi_v_mul, (SFEMI_V a, SFEMI_V b), a.e[i] * b.e[i])
SFEMI_BY_LANE(sfemi_v_fma, (SFEMI_V a, SFEMI_V b, SFEMI_V c), SFEMI_FMA1(a.e[i], b.e[i], c.e[i]))
SFEMI_BY_LANE(sfemi_v_fnma, (SFEMI_V a, SFEMI_V b, SFEMI_V c), SFEMI_FMA1(-a.e[i], b.e[i], c.e[i]))
static SFEMI_INLINE void SFEMI_KERNEL(sfemi_v_store)(SFEMI_R *p, SFEMI_V v)
{
    memcpy(p, v.e, sizeof v.e);
}
#endif
#ifndef SFEMI_LD
#define SFEMI_LD(p)         SFEMI_KERNEL(sfemi_v_load)(p)
#define SFEMI_ST(p, v)      SFEMI_KERNEL(sfemi_v_store)(p, v)
#define SFEMI_DUP(s)        SFEMI_KERNEL(sfemi_v_dup)(s)
#define SFEMI_ADD(a, b)     SFEMI_KERNEL(sfemi_v_add)(a, b)
#define SFEMI_MUL(a, b)     SFEMI_KERNEL(sfemi_v_mul)(a, b)
#define SFEMI_FMA(a, b, c)  SFEMI_KERNEL(sfemi_v_fma)(a, b, c)
#define SFEMI_FNMA(a, b, c) SFEMI_KERNEL(sfemi_v_fnma)(a, b, c)
#endif

#ifdef SFEMI_HALF
#define SFEMI_SUM4(z, out)                                                                         \
    {                                                                                              \
        const __m256d a_ = _mm256_hadd_pd(SFEMI_HALF(z), SFEMI_HALF((z) + SFEMI_W));               \
        const __m256d b_ =                                                                         \
            _mm256_hadd_pd(SFEMI_HALF((z) + 2 * SFEMI_W), SFEMI_HALF((z) + 3 * SFEMI_W));          \
        _mm256_storeu_pd(out, _mm256_add_pd(_mm256_permute2f128_pd(a_, b_, 0x21),                  \
                                            _mm256_blend_pd(a_, b_, 12)));                         \
    }
#endif

/* --- the factor of one front -----------------------------------------------------------------
 *
 * A front has f rows, of which the first k are eliminated. Its rows stand in tiles of 3 vectors,
 * tile t holding rows [t T, t T + H), T = 3 W; within a tile, columns of H numbers stand one after
 * another. Tiles of L have the columns below min(k, (t+1) T), tiles of the update matrix U those
 * from c0, the start of the tile that holds row k. The last tile is only as high as it needs, in
 * whole vectors. So every operand of every product is contiguous, for the factor as for the solve.
 */
#if SFEMI_BITS == 64

/* c(3W x 4) = (or +=) - a b^T over depth columns; then, if tri, the 4 x 4 triangle of the pivot
 * rows behind b is solved for, column q scaled by r[q]. Only the first nq columns are read and
 * written. */
static SFEMI_INLINE SFEMI_TARGET void
SFEMI_KERNEL(sfemi_ldl_block)(int nv, size_t depth, const double *a, size_t ha, const double *b,
                              size_t hb, double *c, int nq, int load, int tri, const double *r)
{
    SFEMI_V c00 = SFEMI_DUP(0), c01 = SFEMI_DUP(0), c02 = SFEMI_DUP(0), c10 = SFEMI_DUP(0),
            c11 = SFEMI_DUP(0), c12 = SFEMI_DUP(0);
    SFEMI_V c20 = SFEMI_DUP(0), c21 = SFEMI_DUP(0), c22 = SFEMI_DUP(0), c30 = SFEMI_DUP(0),
            c31 = SFEMI_DUP(0), c32 = SFEMI_DUP(0);
    SFEMI_V a0 = SFEMI_DUP(0), a1 = SFEMI_DUP(0), a2 = SFEMI_DUP(0);
    size_t p;
    if (load) {
#define SFEMI_C(q)                                                                                 \
    c##q##0 = SFEMI_LD(c + q * ha);                                                                \
    if (nv > 1) c##q##1 = SFEMI_LD(c + q * ha + SFEMI_W);                                          \
    if (nv > 2) c##q##2 = SFEMI_LD(c + q * ha + 2 * SFEMI_W);
        SFEMI_C(0)
        if (nq > 1) {
            SFEMI_C(1)
        }
        if (nq > 2) {
            SFEMI_C(2)
        }
        if (nq > 3) {
            SFEMI_C(3)
        }
#undef SFEMI_C
    }
    for (p = 0; p < depth; ++p) {
        a0 = SFEMI_LD(a);
        if (nv > 1) a1 = SFEMI_LD(a + SFEMI_W);
        if (nv > 2) a2 = SFEMI_LD(a + 2 * SFEMI_W);
#define SFEMI_C(q)                                                                                 \
    c##q##0 = SFEMI_FNMA(a0, SFEMI_DUP(b[q]), c##q##0);                                            \
    if (nv > 1) c##q##1 = SFEMI_FNMA(a1, SFEMI_DUP(b[q]), c##q##1);                                \
    if (nv > 2) c##q##2 = SFEMI_FNMA(a2, SFEMI_DUP(b[q]), c##q##2);
        SFEMI_C(0)
        SFEMI_C(1)
        SFEMI_C(2)
        SFEMI_C(3)
#undef SFEMI_C
        a += ha;
        b += hb;
    }
    if (tri) { /* b is now at the diagonal: b[q + j hb] = s_j L(q, j) */
#define SFEMI_C(q, j)                                                                              \
    c##q##0 = SFEMI_FNMA(c##j##0, SFEMI_DUP(b[q + j * hb]), c##q##0);                              \
    if (nv > 1) c##q##1 = SFEMI_FNMA(c##j##1, SFEMI_DUP(b[q + j * hb]), c##q##1);                  \
    if (nv > 2) c##q##2 = SFEMI_FNMA(c##j##2, SFEMI_DUP(b[q + j * hb]), c##q##2);
#define SFEMI_D(q)                                                                                 \
    c##q##0 = SFEMI_MUL(c##q##0, SFEMI_DUP(r[q]));                                                 \
    if (nv > 1) c##q##1 = SFEMI_MUL(c##q##1, SFEMI_DUP(r[q]));                                     \
    if (nv > 2) c##q##2 = SFEMI_MUL(c##q##2, SFEMI_DUP(r[q]));
        SFEMI_D(0)
        if (nq > 1) {
            SFEMI_C(1, 0) SFEMI_D(1)
        }
        if (nq > 2) {
            SFEMI_C(2, 0) SFEMI_C(2, 1) SFEMI_D(2)
        }
        if (nq > 3) {
            SFEMI_C(3, 0) SFEMI_C(3, 1) SFEMI_C(3, 2) SFEMI_D(3)
        }
#undef SFEMI_C
#undef SFEMI_D
    }
#define SFEMI_C(q)                                                                                 \
    SFEMI_ST(c + q * ha, c##q##0);                                                                 \
    if (nv > 1) SFEMI_ST(c + q * ha + SFEMI_W, c##q##1);                                           \
    if (nv > 2) SFEMI_ST(c + q * ha + 2 * SFEMI_W, c##q##2);
    SFEMI_C(0)
    if (nq > 1) {
        SFEMI_C(1)
    }
    if (nq > 2) {
        SFEMI_C(2)
    }
    if (nq > 3) {
        SFEMI_C(3)
    }
#undef SFEMI_C
}

/* The same for a tile of h rows. */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_update)(size_t h, size_t depth, const double *a,
                                                        const double *b, size_t hb, double *c,
                                                        int nq, int load)
{
    if (h == 3 * SFEMI_W)
        SFEMI_KERNEL(sfemi_ldl_block)(3, depth, a, 3 * SFEMI_W, b, hb, c, nq, load, 0, NULL);
    else if (h == 2 * SFEMI_W)
        SFEMI_KERNEL(sfemi_ldl_block)(2, depth, a, 2 * SFEMI_W, b, hb, c, nq, load, 0, NULL);
    else
        SFEMI_KERNEL(sfemi_ldl_block)(1, depth, a, SFEMI_W, b, hb, c, nq, load, 0, NULL);
}

static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_eliminate)(size_t h, size_t depth, const double *a,
                                                           const double *b, size_t hb, double *c,
                                                           int nq, const double *r)
{
    if (h == 3 * SFEMI_W)
        SFEMI_KERNEL(sfemi_ldl_block)(3, depth, a, 3 * SFEMI_W, b, hb, c, nq, 1, 1, r);
    else if (h == 2 * SFEMI_W)
        SFEMI_KERNEL(sfemi_ldl_block)(2, depth, a, 2 * SFEMI_W, b, hb, c, nq, 1, 1, r);
    else
        SFEMI_KERNEL(sfemi_ldl_block)(1, depth, a, SFEMI_W, b, hb, c, nq, 1, 1, r);
}

/* Factorises nq <= 4 columns c of a diagonal tile, whose first pivot is row i of the tile and which
 * are already updated. r[q] = s / sqrt|d| is the sign and scale of each; returns nq, or the number
 * of the column whose pivot d is lost (not above floor[q] in absolute value, or negative though
 * only positive ones are allowed); it is then in *bad. */
static SFEMI_TARGET int SFEMI_KERNEL(sfemi_ldl_pivots)(size_t h, size_t i, double *c, int nq,
                                                       int positive, const double *floor, double *r,
                                                       double *bad)
{
    int q, j;
    size_t v;
    for (q = 0; q < nq; ++q) {
        double d = c[i + (size_t)q + (size_t)q * h], s = 1;
        for (j = 0; j < q; ++j) { /* left-looking inside the four */
            const double *l = c + (size_t)j * h;
            const double w = r[j] < 0 ? -l[i + (size_t)q] : l[i + (size_t)q];
            for (v = 0; v < h; v += SFEMI_W)
                SFEMI_ST(c + (size_t)q * h + v, SFEMI_FNMA(SFEMI_LD(l + v), SFEMI_DUP(w),
                                                           SFEMI_LD(c + (size_t)q * h + v)));
        }
        d = c[i + (size_t)q + (size_t)q * h];
        if (d < 0 && !positive) s = -1;
        if (!(s * d > floor[q]) || !sfemi_finite(d)) {
            *bad = d;
            return q;
        }
        r[q] = s / sqrt(s * d);
        for (v = 0; v < h; v += SFEMI_W)
            SFEMI_ST(c + (size_t)q * h + v,
                     SFEMI_MUL(SFEMI_LD(c + (size_t)q * h + v), SFEMI_DUP(r[q])));
    }
    return nq;
}

/* Adds an update matrix to its parent: len rows of count block columns, column b of src to column
 * place[b] of dst. */
static SFEMI_INLINE SFEMI_TARGET void
SFEMI_KERNEL(sfemi_ldl_add_rows)(sfem_int count, const sfem_int *place, const size_t len,
                                 const double *src, size_t hs, double *dst, size_t hd)
{
    sfem_int b;
    for (b = 0; b < count; ++b) {
        double *d = dst + 3 * (size_t)place[b] * hd;
        int c;
        for (c = 0; c < 3; ++c, d += hd, src += hs) {
            size_t i = 0;
            for (; i + SFEMI_W <= len; i += SFEMI_W)
                SFEMI_ST(d + i, SFEMI_ADD(SFEMI_LD(d + i), SFEMI_LD(src + i)));
            for (; i < len; ++i) d[i] += src[i];
        }
    }
}

static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_add)(sfem_int count, const sfem_int *place,
                                                     size_t len, const double *src, size_t hs,
                                                     double *dst, size_t hd)
{
    if (len == 3)
        SFEMI_KERNEL(sfemi_ldl_add_rows)(count, place, 3, src, hs, dst, hd);
    else if (len == 6)
        SFEMI_KERNEL(sfemi_ldl_add_rows)(count, place, 6, src, hs, dst, hd);
    else if (len == 9)
        SFEMI_KERNEL(sfemi_ldl_add_rows)(count, place, 9, src, hs, dst, hd);
    else if (len == 12)
        SFEMI_KERNEL(sfemi_ldl_add_rows)(count, place, 12, src, hs, dst, hd);
    else
        SFEMI_KERNEL(sfemi_ldl_add_rows)(count, place, len, src, hs, dst, hd);
}
/* c(n) -= eight columns of a, m apart, times w. */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_dense_minus)(size_t n, const double *a, size_t m,
                                                         const double *w, double *c)
{
    size_t i;
    for (i = 0; i + SFEMI_W <= n; i += SFEMI_W) {
        const double *p = a + i;
        SFEMI_V u = SFEMI_FNMA(SFEMI_LD(p), SFEMI_DUP(w[0]), SFEMI_LD(c + i));
        SFEMI_V v = SFEMI_MUL(SFEMI_LD(p + m), SFEMI_DUP(-w[1]));
        u = SFEMI_FNMA(SFEMI_LD(p + 2 * m), SFEMI_DUP(w[2]), u);
        v = SFEMI_FNMA(SFEMI_LD(p + 3 * m), SFEMI_DUP(w[3]), v);
        u = SFEMI_FNMA(SFEMI_LD(p + 4 * m), SFEMI_DUP(w[4]), u);
        v = SFEMI_FNMA(SFEMI_LD(p + 5 * m), SFEMI_DUP(w[5]), v);
        u = SFEMI_FNMA(SFEMI_LD(p + 6 * m), SFEMI_DUP(w[6]), u);
        v = SFEMI_FNMA(SFEMI_LD(p + 7 * m), SFEMI_DUP(w[7]), v);
        SFEMI_ST(c + i, SFEMI_ADD(u, v));
    }
    for (; i < n; ++i) {
        const double *p = a + i;
        c[i] -= (p[0] * w[0] + p[m] * w[1] + (p[2 * m] * w[2] + p[3 * m] * w[3])) +
                (p[4 * m] * w[4] + p[5 * m] * w[5] + (p[6 * m] * w[6] + p[7 * m] * w[7]));
    }
}

/* out[p] = column p of a, m apart, times x, for four columns. */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_dense_dots)(size_t n, const double *a, size_t m,
                                                        const double *x, double *out)
{
    SFEMI_V s0 = SFEMI_DUP(0), s1 = SFEMI_DUP(0), s2 = SFEMI_DUP(0), s3 = SFEMI_DUP(0);
    double part[4 * SFEMI_W];
    size_t i;
    int p, q;
    for (i = 0; i + SFEMI_W <= n; i += SFEMI_W) {
        s0 = SFEMI_FMA(SFEMI_LD(a + i), SFEMI_LD(x + i), s0);
        s1 = SFEMI_FMA(SFEMI_LD(a + m + i), SFEMI_LD(x + i), s1);
        s2 = SFEMI_FMA(SFEMI_LD(a + 2 * m + i), SFEMI_LD(x + i), s2);
        s3 = SFEMI_FMA(SFEMI_LD(a + 3 * m + i), SFEMI_LD(x + i), s3);
    }
    SFEMI_ST(part, s0);
    SFEMI_ST(part + SFEMI_W, s1);
    SFEMI_ST(part + 2 * SFEMI_W, s2);
    SFEMI_ST(part + 3 * SFEMI_W, s3);
    for (p = 0; p < 4; ++p) {
        out[p] = 0;
        for (q = 0; q < SFEMI_W; ++q) out[p] += part[p * SFEMI_W + q];
    }
    for (; i < n; ++i)
        for (p = 0; p < 4; ++p) out[p] += a[(size_t)p * m + i] * x[i];
}

/* One column of the symmetric matrix that Householder's reduction works on, from its diagonal down: a -=
 * v wj + w vj, the rank-two change of the last reflection, then what the column does to the product y
 * with the next one, u: y += a uj below the diagonal; returns the sum of a u there. */
static SFEMI_TARGET double SFEMI_KERNEL(sfemi_eigen_column)(size_t n, double *a, const double *v,
                                                            const double *w, const double *u,
                                                            double *y)
{
    const SFEMI_V vj = SFEMI_DUP(v[0]), wj = SFEMI_DUP(w[0]), uj = SFEMI_DUP(u[0]);
    SFEMI_V s = SFEMI_DUP(0);
    double part[SFEMI_W], sum = 0;
    size_t i;
    int q;
    a[0] -= 2 * v[0] * w[0];
    for (i = 1; i + SFEMI_W <= n; i += SFEMI_W) {
        SFEMI_V x = SFEMI_FNMA(SFEMI_LD(v + i), wj, SFEMI_LD(a + i));
        x = SFEMI_FNMA(SFEMI_LD(w + i), vj, x);
        SFEMI_ST(a + i, x);
        s = SFEMI_FMA(x, SFEMI_LD(u + i), s);
        SFEMI_ST(y + i, SFEMI_FMA(x, uj, SFEMI_LD(y + i)));
    }
    SFEMI_ST(part, s);
    for (q = 0; q < SFEMI_W; ++q) sum += part[q];
    for (; i < n; ++i) {
        a[i] -= v[i] * w[0] + w[i] * v[0];
        sum += a[i] * u[i];
        y[i] += a[i] * u[0];
    }
    return sum;
}

/* x -= tau v (v.x) */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_eigen_reflect)(size_t n, const double *v, double tau,
                                                           double *x)
{
    SFEMI_V s = SFEMI_DUP(0), t = SFEMI_DUP(0), f;
    double part[SFEMI_W], sum = 0;
    size_t i;
    int q;
    for (i = 0; i + 2 * SFEMI_W <= n; i += 2 * SFEMI_W) {
        s = SFEMI_FMA(SFEMI_LD(v + i), SFEMI_LD(x + i), s);
        t = SFEMI_FMA(SFEMI_LD(v + i + SFEMI_W), SFEMI_LD(x + i + SFEMI_W), t);
    }
    SFEMI_ST(part, SFEMI_ADD(s, t));
    for (q = 0; q < SFEMI_W; ++q) sum += part[q];
    for (; i < n; ++i) sum += v[i] * x[i];
    sum *= tau;
    f = SFEMI_DUP(sum);
    for (i = 0; i + SFEMI_W <= n; i += SFEMI_W)
        SFEMI_ST(x + i, SFEMI_FNMA(SFEMI_LD(v + i), f, SFEMI_LD(x + i)));
    for (; i < n; ++i) x[i] -= v[i] * sum;
}

/* A sweep of plane rotations on neighbouring columns of z, h apart, the last pair first: columns k and
 * k+1 become c_k z_k - s_k z_k+1 and s_k z_k + c_k z_k+1, k = count-1 ... 0; any rows. */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_eigen_sweep)(size_t rows, size_t count, double *z,
                                                         size_t h, const double *c, const double *s)
{
    size_t i = 0, k;
    for (; i + 3 * SFEMI_W <= rows; i += 3 * SFEMI_W) {
        double *p = z + count * h + i;
        SFEMI_V x0 = SFEMI_LD(p), x1 = SFEMI_LD(p + SFEMI_W), x2 = SFEMI_LD(p + 2 * SFEMI_W);
        for (k = count; k-- > 0; p -= h) {
            const SFEMI_V ck = SFEMI_DUP(c[k]), sk = SFEMI_DUP(s[k]);
            double *o = p - h;
            const SFEMI_V y0 = SFEMI_LD(o), y1 = SFEMI_LD(o + SFEMI_W),
                          y2 = SFEMI_LD(o + 2 * SFEMI_W);
            SFEMI_ST(p, SFEMI_FMA(sk, y0, SFEMI_MUL(ck, x0)));
            SFEMI_ST(p + SFEMI_W, SFEMI_FMA(sk, y1, SFEMI_MUL(ck, x1)));
            SFEMI_ST(p + 2 * SFEMI_W, SFEMI_FMA(sk, y2, SFEMI_MUL(ck, x2)));
            x0 = SFEMI_FNMA(sk, x0, SFEMI_MUL(ck, y0));
            x1 = SFEMI_FNMA(sk, x1, SFEMI_MUL(ck, y1));
            x2 = SFEMI_FNMA(sk, x2, SFEMI_MUL(ck, y2));
        }
        SFEMI_ST(p, x0);
        SFEMI_ST(p + SFEMI_W, x1);
        SFEMI_ST(p + 2 * SFEMI_W, x2);
    }
    for (; i < rows; ++i) {
        double *p = z + count * h + i, x = p[0];
        for (k = count; k-- > 0; p -= h) {
            const double y = p[-(ptrdiff_t)h];
            p[0] = s[k] * y + c[k] * x;
            x = c[k] * y - s[k] * x;
        }
        p[0] = x;
    }
}
#endif

/* Replaces the n columns of a finished diagonal tile [L11; L21] by [X; -L21 X], X = L11^-1, from
 * the last column back: X(i,j) = -r_j (sum over p > j of X(i,p) L(p,j)), X(j,j) = r_j = 1 / L(j,j).
 */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_invert)(size_t h, size_t n, SFEMI_R *c,
                                                        const double *r)
{
    SFEMI_R l[3 * SFEMI_W], x[3 * SFEMI_W];
    size_t j, p, v;
    for (j = n; j-- > 0;) {
        const SFEMI_R rj = (SFEMI_R)fabs((double)r[j]);
        memcpy(l, c + j * h, h * sizeof *l);
        memcpy(x, l, h * sizeof *x);
        memset(x, 0, n * sizeof *x);
        for (p = j + 1; p < n; ++p)
            for (v = 0; v < h; v += SFEMI_W)
                SFEMI_ST(x + v,
                         SFEMI_FMA(SFEMI_LD(c + p * h + v), SFEMI_DUP(l[p]), SFEMI_LD(x + v)));
        for (v = 0; v < h; v += SFEMI_W)
            SFEMI_ST(c + j * h + v, SFEMI_MUL(SFEMI_LD(x + v), SFEMI_DUP(-rj)));
        c[j * h + j] = rj;
    }
}

/* --- the solve with one front ----------------------------------------------------------------
 * k pivots, f rows, in tiles as above; on the diagonal stand [X; -L21 X] as sfemi_ldl_invert left
 * them, so that a tile's pivots are one product too. */

/* c = init - a y over depth columns of a tile of nv vectors; the caller stores it. */
#define SFEMI_ACCUMULATE(OP, depth, a, y)                                                          \
    {                                                                                              \
        size_t p_ = 0;                                                                             \
        SFEMI_V d0 = SFEMI_DUP(0), d1 = SFEMI_DUP(0), d2 = SFEMI_DUP(0);                           \
        for (; p_ + 2 <= (depth); p_ += 2, (a) += 2 * h) {                                         \
            c0 = OP(SFEMI_LD(a), SFEMI_DUP((y)[p_]), c0);                                          \
            if (nv > 1) c1 = OP(SFEMI_LD((a) + SFEMI_W), SFEMI_DUP((y)[p_]), c1);                  \
            if (nv > 2) c2 = OP(SFEMI_LD((a) + 2 * SFEMI_W), SFEMI_DUP((y)[p_]), c2);              \
            d0 = OP(SFEMI_LD((a) + h), SFEMI_DUP((y)[p_ + 1]), d0);                                \
            if (nv > 1) d1 = OP(SFEMI_LD((a) + h + SFEMI_W), SFEMI_DUP((y)[p_ + 1]), d1);          \
            if (nv > 2) d2 = OP(SFEMI_LD((a) + h + 2 * SFEMI_W), SFEMI_DUP((y)[p_ + 1]), d2);      \
        }                                                                                          \
        if (p_ < (depth)) {                                                                        \
            c0 = OP(SFEMI_LD(a), SFEMI_DUP((y)[p_]), c0);                                          \
            if (nv > 1) c1 = OP(SFEMI_LD((a) + SFEMI_W), SFEMI_DUP((y)[p_]), c1);                  \
            if (nv > 2) c2 = OP(SFEMI_LD((a) + 2 * SFEMI_W), SFEMI_DUP((y)[p_]), c2);              \
            (a) += h;                                                                              \
        }                                                                                          \
        c0 = SFEMI_ADD(c0, d0);                                                                    \
        if (nv > 1) c1 = SFEMI_ADD(c1, d1);                                                        \
        if (nv > 2) c2 = SFEMI_ADD(c2, d2);                                                        \
    }

/* One tile of the forward sweep: out = [0; first j rows solved] with b = out on entry. Only for
 * pivots (j > 0) is out read. */
static SFEMI_INLINE SFEMI_TARGET void
SFEMI_KERNEL(sfemi_ldl_forward_tile)(int nv, size_t depth, size_t j, const SFEMI_R *a,
                                     const SFEMI_R *y, SFEMI_R *out)
{
    static const SFEMI_R step[6 * SFEMI_W] = {
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
#if SFEMI_W == 8
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
#endif
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        1
    };
    const size_t h = (size_t)nv * SFEMI_W;
    SFEMI_V c0 = SFEMI_DUP(0), c1 = SFEMI_DUP(0), c2 = SFEMI_DUP(0);
    if (j) {
        c0 = SFEMI_LD(out);
        if (nv > 1) c1 = SFEMI_LD(out + SFEMI_W);
        if (nv > 2) c2 = SFEMI_LD(out + 2 * SFEMI_W);
    }
    SFEMI_ACCUMULATE(SFEMI_FNMA, depth, a, y)
    if (j) { /* rows from j on go on as they are, the first j get X times themselves */
        const SFEMI_R *mask = step + 3 * SFEMI_W - j;
        SFEMI_R b[3 * SFEMI_W];
        SFEMI_ST(b, c0);
        c0 = SFEMI_MUL(c0, SFEMI_LD(mask));
        if (nv > 1) {
            SFEMI_ST(b + SFEMI_W, c1);
            c1 = SFEMI_MUL(c1, SFEMI_LD(mask + SFEMI_W));
        }
        if (nv > 2) {
            SFEMI_ST(b + 2 * SFEMI_W, c2);
            c2 = SFEMI_MUL(c2, SFEMI_LD(mask + 2 * SFEMI_W));
        }
        SFEMI_ACCUMULATE(SFEMI_FMA, j, a, b)
    }
    SFEMI_ST(out, c0);
    if (nv > 1) SFEMI_ST(out + SFEMI_W, c1);
    if (nv > 2) SFEMI_ST(out + 2 * SFEMI_W, c2);
}
#undef SFEMI_ACCUMULATE

/* L y = b for the columns x of one front; to its rows below, target[] in nodes of w, -L y is added.
 */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_forward)(size_t k, size_t f, const SFEMI_R *l,
                                                         SFEMI_R *x, const sfem_int *target,
                                                         SFEMI_R *w)
{
    const size_t t = 3 * SFEMI_W;
    size_t begin, i;
    for (begin = 0; begin < f; begin += t) {
        const size_t h = f - begin < t ? (f - begin + SFEMI_W - 1) / SFEMI_W * SFEMI_W : t;
        const size_t depth = begin < k ? begin : k,
                     j = begin < k ? (k - begin < t ? k - begin : t) : 0;
        const size_t rows = f - begin < t ? f - begin : t;
        SFEMI_R out[3 * SFEMI_W];
        if (j) {
            if (j < t) memset(out, 0, sizeof out);
            memcpy(out, x + begin, j * sizeof *x);
        }
        if (h == t)
            SFEMI_KERNEL(sfemi_ldl_forward_tile)(3, depth, j, l, x, out);
        else if (h == 2 * SFEMI_W)
            SFEMI_KERNEL(sfemi_ldl_forward_tile)(2, depth, j, l, x, out);
        else
            SFEMI_KERNEL(sfemi_ldl_forward_tile)(1, depth, j, l, x, out);
        l += h * (depth + j);
        if (j) memcpy(x + begin, out, j * sizeof *x);
        for (i = j; i < rows; i += 3) {
            SFEMI_R *y = w + 3 * (size_t)*target++;
            y[0] += out[i];
            y[1] += out[i + 1];
            y[2] += out[i + 2];
        }
    }
}

/* z(W) of each column p = or += the parts of a(:, p) . x, to be added up later. */
static SFEMI_INLINE SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_dots_tile)(int nv, size_t depth,
                                                                        int first, const SFEMI_R *a,
                                                                        const SFEMI_R *x,
                                                                        SFEMI_R *z)
{
    const size_t h = (size_t)nv * SFEMI_W;
    SFEMI_V x0 = SFEMI_LD(x), x1 = x0, x2 = x0, s;
    size_t p;
    if (nv > 1) x1 = SFEMI_LD(x + SFEMI_W);
    if (nv > 2) x2 = SFEMI_LD(x + 2 * SFEMI_W);
    for (p = 0; p < depth; ++p, a += h, z += SFEMI_W) {
        if (first)
            s = SFEMI_MUL(SFEMI_LD(a), x0);
        else
            s = SFEMI_FMA(SFEMI_LD(a), x0, SFEMI_LD(z));
        if (nv > 1) s = SFEMI_FMA(SFEMI_LD(a + SFEMI_W), x1, s);
        if (nv > 2) s = SFEMI_FMA(SFEMI_LD(a + 2 * SFEMI_W), x2, s);
        SFEMI_ST(z, s);
    }
}

static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_dots)(size_t h, size_t depth, int first,
                                                      const SFEMI_R *a, const SFEMI_R *x,
                                                      SFEMI_R *z)
{
    if (first) {
        if (h == 3 * SFEMI_W)
            SFEMI_KERNEL(sfemi_ldl_dots_tile)(3, depth, 1, a, x, z);
        else if (h == 2 * SFEMI_W)
            SFEMI_KERNEL(sfemi_ldl_dots_tile)(2, depth, 1, a, x, z);
        else
            SFEMI_KERNEL(sfemi_ldl_dots_tile)(1, depth, 1, a, x, z);
    } else
        SFEMI_KERNEL(sfemi_ldl_dots_tile)(3, depth, 0, a, x, z); /* only the last tile is lower */
}

/* out[p] = the sum of the W parts z of column p. */
static SFEMI_INLINE SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_sums)(size_t n, const SFEMI_R *z,
                                                                   SFEMI_R *out)
{
    size_t p = 0;
#ifdef SFEMI_SUM4
    for (; p + 4 <= n; p += 4, z += 4 * SFEMI_W) SFEMI_SUM4(z, out + p);
#endif
    for (; p < n; ++p, z += SFEMI_W)
        out[p] = SFEMI_W == 8
                     ? ((z[0] + z[1]) + (z[2] + z[3])) +
                           ((z[SFEMI_W - 4] + z[SFEMI_W - 3]) + (z[SFEMI_W - 2] + z[SFEMI_W - 1]))
                     : (z[0] + z[1]) + (z[2] + z[3]);
}

/* L^T x = y for the columns x, the rows below being known. v is scratch of f + W k and a tile more.
 */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_backward)(size_t k, size_t f, size_t size,
                                                          const SFEMI_R *l, SFEMI_R *x,
                                                          const sfem_int *target, const SFEMI_R *w,
                                                          SFEMI_R *v)
{
    const size_t t = 3 * SFEMI_W, tiles = (f + t - 1) / t;
    SFEMI_R sum[3 * SFEMI_W], part[3 * SFEMI_W * SFEMI_W], *z = v + tiles * t;
    size_t begin = (tiles - 1) * t, i, h = (f - begin + SFEMI_W - 1) / SFEMI_W * SFEMI_W;
    int first = 1;
    for (i = k; i < f; i += 3) {
        const SFEMI_R *y = w + 3 * (size_t)*target++;
        v[i] = y[0];
        v[i + 1] = y[1];
        v[i + 2] = y[2];
    }
    for (; i < begin + h; ++i) v[i] = 0;
    for (l += size;; begin -= t, h = t, first = 0) {
        const size_t depth = begin < k ? begin : k;
        SFEMI_R *vt = v + begin;
        if (begin < k) {
            const size_t j = k - begin < t ? k - begin : t;
            l -= h * j;
            if (first)
                memset(sum, 0, sizeof sum);
            else
                SFEMI_KERNEL(sfemi_ldl_sums)(j, z + begin * SFEMI_W, sum);
            for (i = 0; i < j; ++i) vt[i] = x[begin + i] - sum[i];
            SFEMI_KERNEL(sfemi_ldl_dots)(h, j, 1, l, vt, part);
            SFEMI_KERNEL(sfemi_ldl_sums)(j, part, vt);
            memcpy(x + begin, vt, j * sizeof *x);
        }
        l -= h * depth;
        SFEMI_KERNEL(sfemi_ldl_dots)(h, depth, first, l, vt, z);
        if (!begin) break;
    }
}

/* --- the same for 8 right sides, which stand side by side ------------------------------------ */

#if SFEMI_W == 8
#define SFEMI_OUTER(X)                                                                             \
    X(0, 0, 0)                                                                                     \
    X(1, 1, 0) X(2, 2, 0) X(3, 3, 0) X(4, 4, 0) X(5, 5, 0) X(6, 6, 0) X(7, 7, 0) X(8, 8, 0)        \
        X(9, 9, 0) X(10, 10, 0) X(11, 11, 0)
#else
#define SFEMI_OUTER(X)                                                                             \
    X(0, 0, 0)                                                                                     \
    X(1, 0, 1) X(2, 1, 0) X(3, 1, 1) X(4, 2, 0) X(5, 2, 1) X(6, 3, 0) X(7, 3, 1) X(8, 4, 0)        \
        X(9, 4, 1) X(10, 5, 0) X(11, 5, 1)
#endif

/* out(g x 8) = or, with load, += or -= the sum over i of a[i across + r down] y(i, :), where r < g
 * = 3/2 W, half a tile's height. */
static SFEMI_INLINE SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_outer)(int load, int minus,
                                                                    size_t depth, const SFEMI_R *a,
                                                                    size_t across, size_t down,
                                                                    const SFEMI_R *y, SFEMI_R *out)
{
#define SFEMI_X(q, r, u) SFEMI_V c##q = SFEMI_DUP(0);
    SFEMI_OUTER(SFEMI_X)
#undef SFEMI_X
    size_t i;
    if (load) {
#define SFEMI_X(q, r, u) c##q = SFEMI_LD(out + 8 * r + SFEMI_W * u);
        SFEMI_OUTER(SFEMI_X)
#undef SFEMI_X
    }
    for (i = 0; i < depth; ++i, a += across, y += 8) {
        const SFEMI_V y0 = SFEMI_LD(y);
#if SFEMI_W == 4
        const SFEMI_V y1 = SFEMI_LD(y + SFEMI_W);
#endif
        if (minus) {
#define SFEMI_X(q, r, u) c##q = SFEMI_FNMA(y##u, SFEMI_DUP(a[r * down]), c##q);
            SFEMI_OUTER(SFEMI_X)
#undef SFEMI_X
        } else {
#define SFEMI_X(q, r, u) c##q = SFEMI_FMA(y##u, SFEMI_DUP(a[r * down]), c##q);
            SFEMI_OUTER(SFEMI_X)
#undef SFEMI_X
        }
    }
#define SFEMI_X(q, r, u) SFEMI_ST(out + 8 * r + SFEMI_W * u, c##q);
    SFEMI_OUTER(SFEMI_X)
#undef SFEMI_X
}

/* to(n x 8) = from, or less what, row by row (memcpy of few rows costs more than the rows). */
static SFEMI_INLINE SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_rows)(size_t n, const SFEMI_R *from,
                                                                   const SFEMI_R *less, SFEMI_R *to)
{
    size_t i;
    for (i = 0; i < 8 * n; i += SFEMI_W)
        SFEMI_ST(to + i, less ? SFEMI_FNMA(SFEMI_LD(less + i), SFEMI_DUP(1), SFEMI_LD(from + i))
                              : SFEMI_LD(from + i));
}

/* The sums may run past a tile's rows or a panel's columns; what they find there is not used. */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_forward8)(size_t k, size_t f, const SFEMI_R *l,
                                                          SFEMI_R *x, const sfem_int *target,
                                                          SFEMI_R *w)
{
    const size_t t = 3 * SFEMI_W, g = t / 2;
    size_t begin, i, r;
    for (begin = 0; begin < f; begin += t) {
        const size_t h = f - begin < t ? (f - begin + SFEMI_W - 1) / SFEMI_W * SFEMI_W : t;
        const size_t depth = begin < k ? begin : k,
                     j = begin < k ? (k - begin < t ? k - begin : t) : 0;
        const size_t rows = f - begin < t ? f - begin : t;
        const SFEMI_V zero = SFEMI_DUP(0);
        SFEMI_R out[3 * SFEMI_W * 8], b[3 * SFEMI_W * 8];
        if (!j) {
            for (r = 0; r < h; r += g)
                SFEMI_KERNEL(sfemi_ldl_outer)(0, 1, depth, l + r, h, 1, x, out + 8 * r);
            l += h * depth;
        } else {
            if (j < t) memset(out, 0, sizeof out);
            SFEMI_KERNEL(sfemi_ldl_rows)(j, x + 8 * begin, NULL, out);
            for (r = 0; depth && r < h; r += g)
                SFEMI_KERNEL(sfemi_ldl_outer)(1, 1, depth, l + r, h, 1, x, out + 8 * r);
            l += h * depth;
            SFEMI_KERNEL(sfemi_ldl_rows)(j, out, NULL, b);
            for (i = 0; i < 8 * j; i += SFEMI_W) SFEMI_ST(out + i, zero);
            for (r = 0; r < h; r += g)
                SFEMI_KERNEL(sfemi_ldl_outer)(1, 0, j, l + r, h, 1, b, out + 8 * r);
            l += h * j;
            SFEMI_KERNEL(sfemi_ldl_rows)(j, out, NULL, x + 8 * begin);
        }
        for (i = j; i < rows; i += 3) {
            SFEMI_R *to = w + 24 * (size_t)*target++;
            for (r = 0; r < 24; r += SFEMI_W)
                SFEMI_ST(to + r, SFEMI_ADD(SFEMI_LD(to + r), SFEMI_LD(out + 8 * i + r)));
        }
    }
}

static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_backward8)(size_t k, size_t f, size_t size,
                                                           const SFEMI_R *l, SFEMI_R *x,
                                                           const sfem_int *target, const SFEMI_R *w,
                                                           SFEMI_R *v)
{
    const size_t t = 3 * SFEMI_W, g = t / 2, tiles = (f + t - 1) / t;
    SFEMI_R part[(3 * SFEMI_W + 3 * SFEMI_W / 2) * 8], *z = v + tiles * t * 8;
    size_t begin = (tiles - 1) * t, i, p, h = (f - begin + SFEMI_W - 1) / SFEMI_W * SFEMI_W;
    int load = 0;
    for (i = k; i < f; i += 3)
        SFEMI_KERNEL(sfemi_ldl_rows)(3, w + 24 * (size_t)*target++, NULL, v + 8 * i);
    memset(v + 8 * i, 0, 8 * (begin + h - i) * sizeof *v);
    for (l += size;; begin -= t, h = t, load = 1) {
        const size_t depth = begin < k ? begin : k;
        SFEMI_R *vt = v + 8 * begin;
        if (begin < k) {
            const size_t j = k - begin < t ? k - begin : t;
            l -= h * j;
            SFEMI_KERNEL(sfemi_ldl_rows)(j, x + 8 * begin, load ? z + 8 * begin : NULL, vt);
            for (p = 0; p < j; p += g)
                SFEMI_KERNEL(sfemi_ldl_outer)(0, 0, h, l + p * h, 1, h, vt, part + 8 * p);
            SFEMI_KERNEL(sfemi_ldl_rows)(j, part, NULL, vt);
            SFEMI_KERNEL(sfemi_ldl_rows)(j, part, NULL, x + 8 * begin);
        }
        l -= h * depth;
        if (load)
            for (p = 0; p < depth; p += g)
                SFEMI_KERNEL(sfemi_ldl_outer)(1, 0, h, l + p * h, 1, h, vt, z + 8 * p);
        else
            for (p = 0; p < depth; p += g)
                SFEMI_KERNEL(sfemi_ldl_outer)(0, 0, h, l + p * h, 1, h, vt, z + 8 * p);
        if (!begin) break;
    }
}
#undef SFEMI_OUTER

/* --- four right sides ------------------------------------------------------------------------
 *
 * Solves and products for blocks of four vectors of doubles, interleaved: what the eigen-solver works
 * with. A row is one vector of 32 bytes on every path. */
#if SFEMI_BITS == 64
#if SFEMI_PATH >= 1
#define SFEMI_V4             __m256d
#define SFEMI_LD4(p)         _mm256_loadu_pd(p)
#define SFEMI_ST4(p, v)      _mm256_storeu_pd(p, v)
#define SFEMI_DUP4(s)        _mm256_set1_pd(s)
#define SFEMI_ADD4(a, b)     _mm256_add_pd(a, b)
#define SFEMI_MUL4(a, b)     _mm256_mul_pd(a, b)
#define SFEMI_FMA4(a, b, c)  _mm256_fmadd_pd(a, b, c)
#define SFEMI_FNMA4(a, b, c) _mm256_fnmadd_pd(a, b, c)
#else
#define SFEMI_V4             SFEMI_V
#define SFEMI_LD4(p)         SFEMI_LD(p)
#define SFEMI_ST4(p, v)      SFEMI_ST(p, v)
#define SFEMI_DUP4(s)        SFEMI_DUP(s)
#define SFEMI_ADD4(a, b)     SFEMI_ADD(a, b)
#define SFEMI_MUL4(a, b)     SFEMI_MUL(a, b)
#define SFEMI_FMA4(a, b, c)  SFEMI_FMA(a, b, c)
#define SFEMI_FNMA4(a, b, c) SFEMI_FNMA(a, b, c)
#endif
#define SFEMI_ROWS12(X) X(0) X(1) X(2) X(3) X(4) X(5) X(6) X(7) X(8) X(9) X(10) X(11)

/* out(12 x 4) = or, with load, += or -= the sum over i of a[i across + r down] y(i, :), r < 12 */
static SFEMI_INLINE SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_outer4)(int load, int minus, size_t depth,
                                                                     const double *a, size_t across,
                                                                     size_t down, const double *y,
                                                                     double *out)
{
#define SFEMI_X(r) SFEMI_V4 c##r = load ? SFEMI_LD4(out + 4 * r) : SFEMI_DUP4(0);
    SFEMI_ROWS12(SFEMI_X)
#undef SFEMI_X
    size_t i;
    for (i = 0; i < depth; ++i, a += across, y += 4) {
        const SFEMI_V4 yi = SFEMI_LD4(y);
        if (minus) {
#define SFEMI_X(r) c##r = SFEMI_FNMA4(yi, SFEMI_DUP4(a[r * down]), c##r);
            SFEMI_ROWS12(SFEMI_X)
#undef SFEMI_X
        } else {
#define SFEMI_X(r) c##r = SFEMI_FMA4(yi, SFEMI_DUP4(a[r * down]), c##r);
            SFEMI_ROWS12(SFEMI_X)
#undef SFEMI_X
        }
    }
#define SFEMI_X(r) SFEMI_ST4(out + 4 * r, c##r);
    SFEMI_ROWS12(SFEMI_X)
#undef SFEMI_X
}
#undef SFEMI_ROWS12

static SFEMI_INLINE SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_rows4)(size_t n, const double *from,
                                                                    const double *less, double *to)
{
    size_t i;
    for (i = 0; i < 4 * n; i += 4)
        SFEMI_ST4(to + i, less ? SFEMI_FNMA4(SFEMI_LD4(less + i), SFEMI_DUP4(1), SFEMI_LD4(from + i))
                               : SFEMI_LD4(from + i));
}

static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_forward4)(size_t k, size_t f, const double *l,
                                                          double *x, const sfem_int *target,
                                                          double *w)
{
    const size_t t = 3 * SFEMI_W, g = 12;
    size_t begin, i, r;
    for (begin = 0; begin < f; begin += t) {
        const size_t h = f - begin < t ? (f - begin + SFEMI_W - 1) / SFEMI_W * SFEMI_W : t;
        const size_t depth = begin < k ? begin : k,
                     j = begin < k ? (k - begin < t ? k - begin : t) : 0;
        const size_t rows = f - begin < t ? f - begin : t;
        const SFEMI_V4 zero = SFEMI_DUP4(0);
        double out[3 * SFEMI_W * 4], b[3 * SFEMI_W * 4];
        if (!j) {
            for (r = 0; r < h; r += g)
                SFEMI_KERNEL(sfemi_ldl_outer4)(0, 1, depth, l + r, h, 1, x, out + 4 * r);
            l += h * depth;
        } else {
            if (j < t) memset(out, 0, sizeof out);
            SFEMI_KERNEL(sfemi_ldl_rows4)(j, x + 4 * begin, NULL, out);
            for (r = 0; depth && r < h; r += g)
                SFEMI_KERNEL(sfemi_ldl_outer4)(1, 1, depth, l + r, h, 1, x, out + 4 * r);
            l += h * depth;
            SFEMI_KERNEL(sfemi_ldl_rows4)(j, out, NULL, b);
            for (i = 0; i < 4 * j; i += 4) SFEMI_ST4(out + i, zero);
            for (r = 0; r < h; r += g)
                SFEMI_KERNEL(sfemi_ldl_outer4)(1, 0, j, l + r, h, 1, b, out + 4 * r);
            l += h * j;
            SFEMI_KERNEL(sfemi_ldl_rows4)(j, out, NULL, x + 4 * begin);
        }
        for (i = j; i < rows; i += 3) {
            double *to = w + 12 * (size_t)*target++;
            for (r = 0; r < 12; r += 4)
                SFEMI_ST4(to + r, SFEMI_ADD4(SFEMI_LD4(to + r), SFEMI_LD4(out + 4 * i + r)));
        }
    }
}

static SFEMI_TARGET void SFEMI_KERNEL(sfemi_ldl_backward4)(size_t k, size_t f, size_t size,
                                                           const double *l, double *x,
                                                           const sfem_int *target, const double *w,
                                                           double *v)
{
    const size_t t = 3 * SFEMI_W, g = 12, tiles = (f + t - 1) / t;
    double part[(3 * SFEMI_W + 12) * 4], *z = v + tiles * t * 4;
    size_t begin = (tiles - 1) * t, i, p, h = (f - begin + SFEMI_W - 1) / SFEMI_W * SFEMI_W;
    int load = 0;
    for (i = k; i < f; i += 3)
        SFEMI_KERNEL(sfemi_ldl_rows4)(3, w + 12 * (size_t)*target++, NULL, v + 4 * i);
    memset(v + 4 * i, 0, 4 * (begin + h - i) * sizeof *v);
    for (l += size;; begin -= t, h = t, load = 1) {
        const size_t depth = begin < k ? begin : k;
        double *vt = v + 4 * begin;
        if (begin < k) {
            const size_t j = k - begin < t ? k - begin : t;
            l -= h * j;
            SFEMI_KERNEL(sfemi_ldl_rows4)(j, x + 4 * begin, load ? z + 4 * begin : NULL, vt);
            for (p = 0; p < j; p += g)
                SFEMI_KERNEL(sfemi_ldl_outer4)(0, 0, h, l + p * h, 1, h, vt, part + 4 * p);
            SFEMI_KERNEL(sfemi_ldl_rows4)(j, part, NULL, vt);
            SFEMI_KERNEL(sfemi_ldl_rows4)(j, part, NULL, x + 4 * begin);
        }
        l -= h * depth;
        if (load)
            for (p = 0; p < depth; p += g)
                SFEMI_KERNEL(sfemi_ldl_outer4)(1, 0, h, l + p * h, 1, h, vt, z + 4 * p);
        else
            for (p = 0; p < depth; p += g)
                SFEMI_KERNEL(sfemi_ldl_outer4)(0, 0, h, l + p * h, 1, h, vt, z + 4 * p);
        if (!begin) break;
    }
}

/* Tall matrices of the eigen-solver: a basis in panels of 24 columns, each [rows][24], stride numbers
 * apart, and blocks [rows][4]; rows a multiple of 24, 96 at a time so that they stay in the first-level
 * cache. */

/* c [24 panels][4] += V^T W */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_modes_dots)(size_t rows, size_t panels, const double *v,
                                                        size_t stride, const double *w, double *c)
{
    size_t at, p, r;
    for (at = 0; at < rows; at += 96) {
        const size_t depth = rows - at < 96 ? rows - at : 96;
        for (p = 0; p < panels; ++p)
            for (r = 0; r < 24; r += 12)
                SFEMI_KERNEL(sfemi_ldl_outer4)(1, 0, depth, v + p * stride + 24 * at + r, 24, 1,
                                              w + 4 * at, c + 4 * (24 * p + r));
    }
}

/* W -= V c, or += */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_modes_combine)(int minus, size_t rows, size_t panels,
                                                           const double *v, size_t stride,
                                                           const double *c, double *w)
{
    size_t at, p, r;
    for (at = 0; at < rows; at += 96) {
        const size_t end = rows - at < 96 ? rows : at + 96;
        for (p = 0; p < panels; ++p)
            for (r = at; r < end; r += 12) {
                if (minus)
                    SFEMI_KERNEL(sfemi_ldl_outer4)(1, 1, 24, v + p * stride + 24 * r, 1, 24, c + 96 * p,
                                                  w + 4 * r);
                else
                    SFEMI_KERNEL(sfemi_ldl_outer4)(1, 0, 24, v + p * stride + 24 * r, 1, 24, c + 96 * p,
                                                  w + 4 * r);
            }
    }
}

/* g [12][4] += A^T B for blocks, of which 4 rows are meant; reads 8 numbers past the end of A. */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_modes_gram)(size_t rows, const double *a, const double *b,
                                                        double *g)
{
    SFEMI_KERNEL(sfemi_ldl_outer4)(1, 0, rows, a, 4, 1, b, g);
}

/* W = W c, c [4][4] */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_modes_turn)(size_t rows, const double *c, double *w)
{
    size_t r;
    for (r = 0; r < rows; r += 12)
        SFEMI_KERNEL(sfemi_ldl_outer4)(0, 0, 4, w + 4 * r, 1, 4, c, w + 4 * r);
}

/* y += A x for four vectors and blocks of 3x3 (val), or of m I (scalar): row i of the lower half, and
 * its mirror image. */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_modes_row)(int i, int first, int last, const sfem_int *col,
                                                       const double *val, const double *scalar,
                                                       const double *x, double *y)
{
    const double *xi = x + 12 * (ptrdiff_t)i;
    const SFEMI_V4 i0 = SFEMI_LD4(xi), i1 = SFEMI_LD4(xi + 4), i2 = SFEMI_LD4(xi + 8);
    SFEMI_V4 s0 = SFEMI_LD4(y + 12 * (ptrdiff_t)i), s1 = SFEMI_LD4(y + 12 * (ptrdiff_t)i + 4),
             s2 = SFEMI_LD4(y + 12 * (ptrdiff_t)i + 8);
    int k;
    for (k = first; k < last; ++k) {
        const double *b = val + 9 * (ptrdiff_t)k, *xj = x + 12 * (ptrdiff_t)col[k];
        double *yj = y + 12 * (ptrdiff_t)col[k];
        const SFEMI_V4 x0 = SFEMI_LD4(xj), x1 = SFEMI_LD4(xj + 4), x2 = SFEMI_LD4(xj + 8);
        SFEMI_V4 y0, y1, y2;
        if (scalar) {
            const SFEMI_V4 m = SFEMI_DUP4(scalar[k]);
            s0 = SFEMI_FMA4(m, x0, s0);
            s1 = SFEMI_FMA4(m, x1, s1);
            s2 = SFEMI_FMA4(m, x2, s2);
            if (col[k] == i) continue;
            SFEMI_ST4(yj, SFEMI_FMA4(m, i0, SFEMI_LD4(yj)));
            SFEMI_ST4(yj + 4, SFEMI_FMA4(m, i1, SFEMI_LD4(yj + 4)));
            SFEMI_ST4(yj + 8, SFEMI_FMA4(m, i2, SFEMI_LD4(yj + 8)));
            continue;
        }
#define SFEMI_X(s, p, q, r, v0, v1, v2)                                                              \
    s = SFEMI_FMA4(SFEMI_DUP4(b[p]), v0, s);                                                         \
    s = SFEMI_FMA4(SFEMI_DUP4(b[q]), v1, s);                                                         \
    s = SFEMI_FMA4(SFEMI_DUP4(b[r]), v2, s);
        SFEMI_X(s0, 0, 1, 2, x0, x1, x2)
        SFEMI_X(s1, 3, 4, 5, x0, x1, x2)
        SFEMI_X(s2, 6, 7, 8, x0, x1, x2)
        if (col[k] == i) continue;
        y0 = SFEMI_LD4(yj);
        y1 = SFEMI_LD4(yj + 4);
        y2 = SFEMI_LD4(yj + 8);
        SFEMI_X(y0, 0, 3, 6, i0, i1, i2)
        SFEMI_X(y1, 1, 4, 7, i0, i1, i2)
        SFEMI_X(y2, 2, 5, 8, i0, i1, i2)
#undef SFEMI_X
        SFEMI_ST4(yj, y0);
        SFEMI_ST4(yj + 4, y1);
        SFEMI_ST4(yj + 8, y2);
    }
    SFEMI_ST4(y + 12 * (ptrdiff_t)i, s0);
    SFEMI_ST4(y + 12 * (ptrdiff_t)i + 4, s1);
    SFEMI_ST4(y + 12 * (ptrdiff_t)i + 8, s2);
}

/* d [k][4] += z_k^T x or x -= z_k d_k over the three rows of a node, k < count; z_k a stride apart */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_modes_project)(int subtract, int count, const double *z,
                                                           size_t stride, double *x, double *d)
{
    int k, c;
    for (k = 0; k < count; ++k, z += stride, d += 4) {
        SFEMI_V4 s = SFEMI_LD4(d);
        for (c = 0; c < 3; ++c) {
            if (subtract)
                SFEMI_ST4(x + 4 * c, SFEMI_FNMA4(SFEMI_DUP4(z[c]), s, SFEMI_LD4(x + 4 * c)));
            else
                s = SFEMI_FMA4(SFEMI_DUP4(z[c]), SFEMI_LD4(x + 4 * c), s);
        }
        if (!subtract) SFEMI_ST4(d, s);
    }
}

/* to = from * factor for the three rows of a node */
static SFEMI_TARGET void SFEMI_KERNEL(sfemi_modes_scale)(const double *factor, const double *from,
                                                         double *to)
{
    int c;
    for (c = 0; c < 3; ++c)
        SFEMI_ST4(to + 4 * c, SFEMI_MUL4(SFEMI_DUP4(factor[c]), SFEMI_LD4(from + 4 * c)));
}
#undef SFEMI_V4
#undef SFEMI_LD4
#undef SFEMI_ST4
#undef SFEMI_DUP4
#undef SFEMI_ADD4
#undef SFEMI_MUL4
#undef SFEMI_FMA4
#undef SFEMI_FNMA4
#endif

#undef SFEMI_TARGET
#undef SFEMI_R
#undef SFEMI_W
#undef SFEMI_V
#undef SFEMI_LD
#undef SFEMI_ST
#undef SFEMI_DUP
#undef SFEMI_ADD
#undef SFEMI_MUL
#undef SFEMI_FMA
#undef SFEMI_FNMA
#undef SFEMI_HALF
#undef SFEMI_SUM4
#undef SFEMI_KERNEL
#undef SFEMI_PASTE
#undef SFEMI_PASTE3
#undef SFEMI_BITS
#undef SFEMI_PATH
#endif /* SFEMI_PATH */

/* ============================================================================================
 * CHANGES
 *   0.1.0   meshes, sparse solver, linear and nonlinear bodies, (p,q,r), Newmark and its kin, handles
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
