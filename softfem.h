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
 *            >>api-matrix   sparse and dense matrices, solvers    >>api-element >>api-model
 *            >>api-body
 *     IMPL   >>base         status, allocation, threads, vector paths
 *            >>math         3-vectors, 3x3 matrices, polar and singular value decomposition
 *            >>mesh         tets, surface, generators, checks, renumbering
 *            >>meshio       readers and writers (left out by SFEM_NO_STDIO)
 *            >>sparse       3x3-block matrices, ordering, LDL^T, dense, conjugate gradients
 *            >>element      linear, corotational, StVK, neo-Hookean tetrahedron; edge lengths
 *            >>fem          assembly, mass, damping, forces, tangents, loads, stress
 *            >>factor       the shared factor of a body's system matrix
 *            >>state        what of a body changes, in one block of memory
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
    const sfem_matrix *damping;   /* added to D, N s/m: any symmetric matrix within K's pattern, or NULL */
    sfem_allocator allocator;
} sfem_model_def;

SFEM_DEF sfem_model_def sfem_default_model_def(void);

/* Builds a model of linear tetrahedra, K_e = V B^T C B.
 *   errors  SFEM_BAD_MESH (empty, index out of range, flat or left-handed tet, a node in no tet),
 *           SFEM_NOT_FINITE, SFEM_BAD_ARGUMENT (material, region, damping pattern), SFEM_OUT_OF_MEMORY,
 *           SFEM_TOO_LARGE; the text names the tet or node
 *   cost    O(tets), about 0.2 us a tet */
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
 * >>api-body   a body that moves
 * ============================================================================================ */

/* M u'' + D u' + K u = F. All three are of the family  A a = rhs, A = r M + (q/2) h D + p h^2 K, and
 * share factors:
 *   SFEM_PQR      one solve with a constant A:  A a = F - f(u) - D w,  w' = w + h a,  u' = u + h w'
 *                 [Yuan et al. 2017, "A novel unconditionally stable explicit integration method for
 *                 finite element method"]. (p,1,1) is Newmark(beta = p, gamma = 1/2).
 *   SFEM_NEWMARK  Newmark(beta, gamma) in accelerations [Newmark 1959]
 *   SFEM_CENTRAL  central difference, p = 0; refused beyond its stable step */
typedef enum sfem_integrator { SFEM_PQR, SFEM_NEWMARK, SFEM_CENTRAL } sfem_integrator;

/* How (p,q,r) starts from u0, v0. Newmark's own first step (default), or for p = 1/12 without
 * damping a start of fourth order. */
typedef enum sfem_start { SFEM_START_NEWMARK, SFEM_START_FOURTH_ORDER } sfem_start;

#define SFEM_P_AUTO (-1.0) /* p = 1/12 where every mode is resolved (omega_max h < 2), else 1/4 */

enum { SFEM_AXIS_X = 1, SFEM_AXIS_Y = 2, SFEM_AXIS_Z = 4, SFEM_AXIS_ALL = 7 };

typedef struct sfem_body sfem_body;

typedef struct sfem_body_def {
    sfem_integrator integrator;
    sfem_real p, q, r;        /* >= 0 (p also SFEM_P_AUTO), >= 0, > 0. Unconditionally stable for p >= 1/4,
                               * q >= 1. r multiplies the mass and nothing else: keep it 1, r = 3 is a
                               * body that falls at g/3. q != 1 adds the mass (q-1) h D/2. */
    sfem_real beta, gamma;    /* of Newmark: beta > 0, gamma >= 1/2 */
    sfem_start start;
    int plain_load;           /* (p,q,r): F at the start of the step alone, as the source has it, instead
                               * of p F+ + (1-2p) F + p F-, which makes it equal Newmark */
    sfem_real alpha, beta_k;  /* Rayleigh damping of the whole body, added to the model's: 1/s, s */
    sfem_real gravity[3];     /* m/s^2 */
    const sfem_int *pins;     /* [pin_count] nodes eliminated from the matrix; copied */
    const unsigned char *pin_axes; /* [pin_count] which axes are held, SFEM_AXIS_*; NULL: all */
    sfem_int pin_count;
    sfem_int max_handles;     /* handles at a time; memory 9*8*nodes bytes for each in use */
    sfem_precision precision;
    sfem_ordering ordering;   /* of the factorisation */
    int no_allocation;        /* a step that would have to allocate returns SFEM_NOT_PREPARED instead */
    sfem_allocator allocator;
    sfem_exec exec;
} sfem_body_def;

/* (p,q,r) with p = 1/4, q = r = 1; Newmark 1/4, 1/2; gravity 0; 16 handles. */
SFEM_DEF sfem_body_def sfem_default_body_def(void);

/* Creates a body at rest in its rest position. Nothing is factored yet. O(nodes).
 *   errors  SFEM_BAD_ARGUMENT, SFEM_NOT_FINITE, SFEM_OUT_OF_MEMORY */
SFEM_DEF sfem_status sfem_body_create(sfem_model *model, const sfem_body_def *def, sfem_body **out,
                                      sfem_error *err);
SFEM_DEF void sfem_body_free(sfem_body *body); /* NULL allowed */

/* Makes whatever a step of h seconds needs and is not there: a factor, unless another body of the model
 * has one with the same matrix and pins; the handles' columns (three solves a handle). The only
 * function after creation that allocates. sfem_body_step calls it where it has to.
 *   errors  SFEM_BAD_ARGUMENT (h), SFEM_UNSTABLE (names the stable step), SFEM_NOT_SPD (names a node that
 *           nothing holds), SFEM_OUT_OF_MEMORY */
SFEM_DEF sfem_status sfem_body_prepare(sfem_body *body, sfem_real h, sfem_error *err);

/* One step of h seconds: predict, solve, finish. On failure the state is as it was.
 *   errors  those of sfem_body_prepare; SFEM_NOT_PREPARED with no_allocation; SFEM_NOT_FINITE
 *   cost    one product with K and one solve, O(nnz(L)) */
SFEM_DEF sfem_status sfem_body_step(sfem_body *body, sfem_real h, sfem_error *err);

/* The same in three parts, for callers who put forces and constraints of their own (contact) between
 * them. predict fills the right side; sfem_body_rhs points at it until solve: a force added there acts
 * during this step. solve leaves the step's acceleration where sfem_body_acceleration points. finish
 * takes the step. predict may be called again to give a step up. */
SFEM_DEF sfem_status sfem_body_predict(sfem_body *body, sfem_real h, sfem_error *err);
SFEM_DEF sfem_status sfem_body_solve(sfem_body *body, sfem_error *err);
SFEM_DEF void sfem_body_finish(sfem_body *body);
SFEM_DEF sfem_real *sfem_body_rhs(sfem_body *body);          /* [nodes][3], N */
SFEM_DEF sfem_real *sfem_body_acceleration(sfem_body *body); /* [nodes][3], m/s^2 */

/* Static equilibrium K u = F under the forces, gravity, pins and handles of now; velocity becomes zero.
 * Handles that are nodes count as pins here.
 *   errors  SFEM_NOT_SPD: "node 17 is held by nothing" and the like */
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
    sfem_real kinetic, elastic, load; /* 1/2 v.Mv, 1/2 u.Ku, -(F + Mg).u; J */
    sfem_real total;                  /* their sum */
    sfem_real conserved; /* what the integrator conserves exactly, undamped and under constant load: for
                          * (p,q,r) 1/2 w.(r M + p h^2 K) w + (E + E-)/2 - (u-u-).(f-f-)/4 - F.(u+u-)/2,
                          * for Newmark(beta, 1/2) the total + (beta - 1/4) h^2/2 a.M a's counterpart */
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

#ifdef __cplusplus
}
#endif
#endif /* SOFTFEM_H */

/* ============================================================================================ */
#if defined(SOFTFEM_IMPLEMENTATION) && !defined(SFEMI_IMPLEMENTED)
#define SFEMI_IMPLEMENTED

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

/* Instruction sets that hot kernels are compiled for on top of what the compiler was told to
 * use. */
#if defined(__GNUC__) && defined(__x86_64__) && !defined(SFEM_NO_DISPATCH)
#define SFEMI_X86_PATHS
#include <immintrin.h>
#define SFEMI_AVX2   __attribute__((target("avx2,fma")))
#define SFEMI_AVX512 __attribute__((target("avx512f,avx512dq,avx512vl,avx2,fma")))
#endif

#if defined(__GNUC__)
#define SFEMI_INLINE static inline __attribute__((always_inline))
#else
#define SFEMI_INLINE static inline
#endif

SFEM_DEF int sfem_vector_width(void)
{
#ifdef SFEMI_X86_PATHS
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl"))
        return 8;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return 4;
#endif
    return 1;
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
    m.nodes = (sfem_int)nodes;
    m.tets = (sfem_int)tets;
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

SFEM_DEF int sfem_mesh_locate(const sfem_mesh *mesh, const sfem_real *x, const sfem_real point[3],
                              sfem_int *tet, sfem_real bary[4])
{
    sfem_real g[3][3], p[3], b[4], best[4], inside = -SFEMI_MESH_INSIDE, low;
    sfem_int t, found = -1;
    int i;
    SFEM_ASSERT(mesh && point);
    if (!x) x = mesh->x;
    for (t = 0; t < mesh->tets; ++t) {
        const sfem_int *v = mesh->tet + 4 * (size_t)t;
        if (!sfemi_mesh_gradients(x, v, g)) continue;
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
    sfem_real unit[3], b[4], best[4], enter, nearest = 0, length = 0;
    sfem_int t, found = -1;
    int i;
    SFEM_ASSERT(mesh && origin && direction);
    if (!x) x = mesh->x;
    for (i = 0; i < 3; ++i)
        if (fabs(direction[i]) > length) length = fabs(direction[i]);
    if (!(length > 0) || !sfemi_finite(length)) return 0;
    for (i = 0; i < 3; ++i) unit[i] = direction[i] / length; /* no under- or overflow in the norm */
    length = sqrt(sfemi_dot3(unit, unit));
    for (i = 0; i < 3; ++i) unit[i] /= length;
    for (t = 0; t < mesh->tets; ++t) {
        if (!sfemi_mesh_clip(x, mesh->tet + 4 * (size_t)t, origin, unit, &enter, b)) continue;
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

/* ============================================================================================
 * >>sparse   3x3-block matrices, ordering, LDL^T, dense, conjugate gradients
 * ============================================================================================ */

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
    sfem_polar(f, r, NULL);
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
        sfem_polar(f, m->u, NULL);
    else if (law != SFEM_LINEAR)
        sfemi_law_svd(f, m->u, s, m->v);
    sfemi_law_derivatives(law, lambda, mu, s, m->a, flip, twist);
    if (kind != SFEM_TANGENT_EXACT && law >= SFEM_STVK) sfemi_law_project(m->a);
    for (i = 0; i < 3; ++i) {
        if (kind != SFEM_TANGENT_EXACT) {
            flip[i] = fmax(flip[i], 0);
            twist[i] =
                law == SFEM_COROTATIONAL && kind == SFEM_TANGENT_FROZEN ? 0 : fmax(twist[i], 0);
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
SFEMI_INLINE void sfemi_pairs_entries(const sfemi_modes *m, sfem_real volume, sfemi_pairs *w,
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

SFEMI_INLINE void sfemi_pairs_blocks(const sfemi_modes *m, sfem_real volume, sfemi_pairs *w)
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

#ifdef SFEMI_X86_PATHS
SFEMI_AVX2 static void sfemi_pairs_avx2(const sfemi_modes *m, sfem_real volume, sfemi_pairs *w)
{
    sfemi_pairs_blocks(m, volume, w);
}
#endif

static sfemi_pairs_kernel sfemi_pairs_pick(void)
{
#ifdef SFEMI_X86_PATHS
    if (sfem_vector_width() >= 4) return sfemi_pairs_avx2;
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
    det = sqrt(fmax(1 + third, 0));
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

#ifdef SFEMI_X86_PATHS
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
static void sfemi_lanes_repair(const sfem_real g[9], sfem_real r[9])
{
    sfem_real f[9];
    int i;
    for (i = 0; i < 9; ++i) f[i] = g[i] + (i % 4 ? 0 : 1);
    sfem_polar(f, r, NULL);
}

/* Is any of the flags, 0 or 1, not 0? */
SFEMI_INLINE int sfemi_lanes_any(const void *flags, size_t bytes)
{
    uint64_t word[SFEMI_LANES], any = 0;
    size_t i;
    memcpy(word, flags, bytes);
    for (i = 0; i < bytes / sizeof *word; ++i) any |= word[i];
    return any != 0;
}

/* MA = a b + c, DOT = a0 b0 + a1 b1 + a2 b2, DET = a b - c d, rounded as the path does it */
#define SFEMI_LANE_ARITHMETIC(T, S)                                                                \
SFEMI_INLINE T sfemi_ma_##S(const int fused, T a, T b, T c)                                        \
{                                                                                                  \
    return fused ? SFEMI_FMA_##S(a, b, c) : a * b + c;                                             \
}                                                                                                  \
SFEMI_INLINE T sfemi_dot_##S(const int fused, T a0, T b0, T a1, T b1, T a2, T b2)                  \
{                                                                                                  \
    return sfemi_ma_##S(fused, a0, b0, sfemi_ma_##S(fused, a1, b1, a2 * b2));                      \
}                                                                                                  \
SFEMI_INLINE T sfemi_det_##S(const int fused, T a, T b, T c, T d)                                  \
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
SFEMI_INLINE void sfemi_lanes_deform_##S(sfemi_lanes_##S *w, const sfemi_block *block,             \
                                         const int fused)                                          \
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
SFEMI_INLINE void sfemi_lanes_quartic_##S(sfemi_lanes_##S *w, const int fused)                     \
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
SFEMI_INLINE void sfemi_lanes_halley_##S(sfemi_lanes_##S *w, const int fused)                      \
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
SFEMI_INLINE void sfemi_lanes_rotation_##S(sfemi_lanes_##S *w, const int fused)                    \
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
SFEMI_INLINE void sfemi_lanes_polar_##S(sfemi_lanes_##S *w, const int fused)                       \
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
        sfemi_lanes_repair(g, r);                                                                  \
        for (i = 0; i < 9; ++i) w->r[i][l] = (T)r[i];                                              \
    }                                                                                              \
}                                                                                                  \
                                                                                                   \
SFEMI_INLINE void sfemi_lanes_linear_##S(sfemi_lanes_##S *w, const int fused)                      \
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
SFEMI_INLINE void sfemi_lanes_corotational_##S(sfemi_lanes_##S *w, const int fused)                \
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
SFEMI_INLINE void sfemi_lanes_stvk_##S(sfemi_lanes_##S *w, const int fused)                        \
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
SFEMI_INLINE void sfemi_lanes_neohookean_##S(sfemi_lanes_##S *w, const int fused)                  \
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
SFEMI_INLINE void sfemi_lanes_forces_##S(sfemi_lanes_##S *w, const sfemi_block *block,             \
                                         const int fused)                                          \
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
SFEMI_INLINE void sfemi_lanes_blocks_##S(const sfemi_block *block, sfem_int count,                 \
                                         const sfem_real *u, sfem_real *out, sfem_real *rotation,  \
                                         sfemi_totals *totals, const sfemi_gather gather,          \
                                         const sfemi_scatter scatter, const int fused)             \
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
#ifdef SFEMI_X86_PATHS
SFEMI_BLOCKS_KERNEL(sfemi_blocks_avx2_d, d, avx2, 1, SFEMI_AVX2)
SFEMI_BLOCKS_KERNEL(sfemi_blocks_avx2_f, f, avx2, 1, SFEMI_AVX2)
SFEMI_BLOCKS_KERNEL(sfemi_blocks_avx512_d, d, avx2, 1, SFEMI_AVX512)
SFEMI_BLOCKS_KERNEL(sfemi_blocks_avx512_f, f, avx2, 1, SFEMI_AVX512)
#endif

/* The widest path that this processor has. */
static sfemi_blocks_kernel sfemi_blocks_pick(sfem_precision precision)
{
    const int mixed = precision == SFEM_MIXED;
#ifdef SFEMI_X86_PATHS
    switch (sfem_vector_width()) {
    case 8: return mixed ? sfemi_blocks_avx512_f : sfemi_blocks_avx512_d;
    case 4: return mixed ? sfemi_blocks_avx2_f : sfemi_blocks_avx2_d;
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
    sfem_int *row, *col;       /* the pattern, [nodes+1], [blocks] */
    sfem_real *node_mass;      /* [nodes] row sums of M; 0 at a node that is in no tet */
    sfem_real *block_mass;     /* [blocks] consistent M, or NULL */
    sfem_real *damping;        /* [blocks][3][3] what alpha and beta leave of D, or NULL */
    sfem_real alpha, beta;     /* Rayleigh damping that all tets share */
    sfem_real *lambda, *mu;    /* [tets] Lame's parameters, Pa */
    sfem_real *density;        /* [tets] kg/m^3 */
    sfem_real *volume;         /* [tets] */
    unsigned char *law;        /* [tets] sfem_law */
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
    sfem_int law, e, i, blocks, tets, last = first;
    for (law = 0; law <= SFEM_NEOHOOKEAN; ++law) {
        for (e = first, tets = 0; e < end; ++e) tets += model->law[e] == law;
        blocks = (tets + SFEMI_LANES - 1) / SFEMI_LANES;
        for (e = first, i = 0; e < end; ++e) {
            if (model->law[e] != law) continue;
            sfemi_chunks_fill(model, e, 0, local, block + i % blocks, i / blocks);
            last = e;
            ++i;
        }
        for (; i < blocks * SFEMI_LANES; ++i)
            sfemi_chunks_fill(model, last, 1, local, block + i % blocks, i / blocks);
        for (i = 0; i < blocks; ++i) block++->law = law;
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
    sfem_int *mark = NULL, *local = NULL, i, a, b, *place;
    sfem_status status = SFEM_OK;
    c->count = (mesh->tets + SFEMI_CHUNK_TETS - 1) / SFEMI_CHUNK_TETS;
    SFEMI_NEW(sfem_int, mark, al, (size_t)mesh->nodes + (size_t)c->count);
    SFEMI_NEW(sfem_int, local, al, (size_t)mesh->nodes + (size_t)c->count);
    SFEMI_NEW(sfem_int, c->block_start, al, (size_t)c->count + 1);
    SFEMI_NEW(sfem_int, c->copy_start, al, (size_t)c->count + 1);
    SFEMI_NEW(sfem_int, c->color_start, al, (size_t)c->count + 1);
    SFEMI_NEW(sfem_int, c->color_chunk, al, c->count);
    SFEMI_NEW(sfem_int, c->node_start, al, (size_t)mesh->nodes + 1);
    SFEMI_NEW(sfem_int, c->place, al, 10 * (size_t)mesh->tets);
    memset(mark, -1, (size_t)mesh->nodes * sizeof *mark);
    sfemi_chunks_count(model, c, mark);
    SFEMI_NEW(sfemi_block, c->block, al, c->block_start[c->count]);
    SFEMI_NEW(sfem_int, c->copy_node, al, c->copies);
    SFEMI_NEW(sfem_int, c->node_copy, al, c->copies);
    memset(mark, -1, (size_t)mesh->nodes * sizeof *mark);
    sfemi_chunks_number(model, c, mark, local);
    sfemi_chunks_color(c, local, mark);
    for (i = 0, place = c->place; i < mesh->tets; ++i)
        for (a = 0; a < 4; ++a)
            for (b = 0; b <= a; ++b) {
                const sfem_int n = mesh->tet[4 * i + a], m = mesh->tet[4 * i + b];
                *place++ = sfemi_fem_find(model->row, model->col, n > m ? n : m, n > m ? m : n);
            }
done:
    sfemi_delete(al, mark);
    sfemi_delete(al, local);
    return status;
}

/* Adds tet e to K, M and the part of D that is its own: alpha_e - alpha, beta_e - beta. */
static void sfemi_fem_add_tet(sfem_model *model, sfem_int e, const sfem_material *m)
{
    const sfem_int *t = model->mesh.tet + 4 * (size_t)e;
    const sfem_real da = m->alpha - model->alpha, db = m->beta - model->beta;
    sfem_real g[4][3], k[9], node;
    int a, b, i;
    const sfem_real v = model->volume[e] = sfemi_element_gradients(&model->mesh, e, g);
    sfem_law_lame(m->young, m->poisson, &model->lambda[e], &model->mu[e]);
    model->law[e] = (unsigned char)m->law;
    model->density[e] = m->density;
    node = m->density * v / 20;
    for (a = 0; a < 4; ++a) {
        model->node_mass[t[a]] += 5 * node;
        for (b = 0; b < 4; ++b) {
            sfem_int at;
            sfem_real *d, *kk;
            if (t[a] < t[b]) continue;
            at = sfemi_fem_find(model->row, model->col, t[a], t[b]);
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
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "the damping matrix has %d block rows, the mesh %d nodes",
                          (int)d->n, (int)model->mesh.nodes);
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
            for (j = 0; j < 9; ++j) model->damping[9 * (size_t)at + (size_t)j] += d->val[9 * (size_t)k + (size_t)j];
        }
    }
    return SFEM_OK;
}

static void sfemi_fem_destroy(sfem_model *model)
{
    const sfem_allocator al = model->allocator;
    sfem_mesh_free(&model->mesh);
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
    SFEMI_TRY(sfem_mesh_copy(mesh->nodes, mesh->x, mesh->tets, mesh->tet, al, &model->mesh, err));
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
    if (def->mass == SFEM_MASS_CONSISTENT) SFEMI_NEW(sfem_real, model->block_mass, al, blocks);
    if (def->damping || sfemi_fem_damping_varies(def))
        SFEMI_NEW(sfem_real, model->damping, al, 9 * blocks);
    model->stiffness.n = mesh->nodes;
    model->stiffness.row = model->row;
    model->stiffness.col = model->col;
done:
    return status;
}

SFEM_DEF sfem_status sfem_model_create(const sfem_model_def *def, sfem_model **out, sfem_error *err)
{
    const sfem_material *materials = def->materials ? def->materials : &def->material;
    sfem_model *model = NULL;
    sfem_status status;
    sfem_int i;
    SFEM_ASSERT(def && out && def->mesh);
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

SFEM_DEF sfem_status sfem_model_combine(const sfem_model *model, sfem_real k, sfem_real m, sfem_real d,
                                        const sfem_allocator *allocator, sfem_matrix *out,
                                        sfem_error *err)
{
    sfem_matrix a;
    sfem_int i, at;
    sfem_status status = sfem_matrix_create(model->mesh.nodes, model->row, model->col, allocator, &a, err);
    if (status != SFEM_OK) return status;
    for (i = 0; i < a.n; ++i)
        for (at = a.row[i]; at < a.row[i + 1]; ++at)
            sfemi_fem_block(model, at, i, k + d * model->beta, m + d * model->alpha, d,
                            a.val + 9 * (size_t)at);
    *out = a;
    return SFEM_OK;
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
 * >>factor   the shared factor of a body's system matrix
 *
 * A = ck K + cm M + cd (rest of D) on the nodes that are not pinned on all axes; axes pinned one by one
 * keep their row as ck K_ii + .. on the diagonal and zero elsewhere. All bodies of a model with the
 * same coefficients and pins use one factor: it is looked up in the model's list, under its lock, and
 * goes when its last body lets go. A factor never changes after it is made.
 * ============================================================================================ */

typedef struct sfemi_factor_key {
    sfem_real ck, cm, cd;
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
           f->key.precision == key->precision && f->key.ordering == key->ordering &&
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
        }
        if (!sfemi_factor_matches(f, &k, nodes)) continue;
        ++f->references;
        break;
    }
    sfemi_unlock(&model->lock);
    return f;
}

/* The rows and columns of A that are free, with held axes of partly held nodes decoupled. */
static sfem_status sfemi_factor_matrix(const sfem_model *model, const sfem_factor *f, sfem_matrix *out,
                                       sfem_error *err)
{
    const sfem_allocator *al = &model->allocator;
    sfem_int *number = NULL, *row = NULL, *col = NULL, i, k, at, blocks = 0;
    sfem_status status = SFEM_OK;
    SFEMI_NEW(sfem_int, number, al, model->mesh.nodes);
    SFEMI_NEW(sfem_int, row, al, (size_t)f->free_nodes + 1);
    SFEMI_NEW(sfem_int, col, al, model->row[model->mesh.nodes]);
    for (i = 0; i < model->mesh.nodes; ++i) number[i] = -1;
    for (k = 0; k < f->free_nodes; ++k) number[f->node[k]] = k;
    for (k = 0; k < f->free_nodes; ++k) {
        i = f->node[k];
        for (at = model->row[i]; at < model->row[i + 1]; ++at)
            if (number[model->col[at]] >= 0) col[blocks++] = number[model->col[at]];
        row[k + 1] = blocks;
    }
    SFEMI_TRY(sfem_matrix_create(f->free_nodes, row, col, al, out, err));
    blocks = 0;
    for (k = 0; k < f->free_nodes; ++k) {
        i = f->node[k];
        for (at = model->row[i]; at < model->row[i + 1]; ++at) {
            const sfem_int j = model->col[at];
            sfem_real *b = out->val + 9 * (size_t)blocks;
            int r, c;
            if (number[j] < 0) continue;
            sfemi_fem_block(model, at, i, f->key.ck, f->key.cm, f->key.cd, b);
            for (r = 0; r < 3; ++r)
                for (c = 0; c < 3; ++c)
                    if (((f->mask[i] >> r & 1) || (f->mask[j] >> c & 1)) && !(i == j && r == c))
                        b[3 * r + c] = 0;
            ++blocks;
        }
    }
done:
    sfemi_delete(al, col);
    sfemi_delete(al, row);
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
    sfem_matrix_free(&a);
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
    sfem_int started;   /* 0: w holds v, the first step comes next; 1: sfem_body_start was called */
    sfem_int load_age;  /* steps since the load last changed, up to 2 */
    sfem_int loaded;    /* the load was ever set */
    sfem_int unused;
} sfemi_state_head;

enum { SFEMI_NOT_STARTED, SFEMI_LOAD_FIXED, SFEMI_RUNNING };

/* The block: head, then these, in this order. w is the velocity for Newmark and before the first step,
 * the mean velocity over the last step for (p,q,r). */
typedef struct sfemi_state {
    sfemi_state_head *head;
    sfem_real *u, *w, *a;  /* [nodes][3] */
    sfem_real *force[3];   /* [nodes][3] at the end of the next step, at its start, one step before */
    sfemi_hold *pin;       /* [pin_count] */
    sfemi_handle *handle;  /* [max_handles] */
} sfemi_state;

static size_t sfemi_state_bytes(sfem_int nodes, sfem_int pins, sfem_int handles)
{
    return sizeof(sfemi_state_head) + 18 * (size_t)nodes * sizeof(sfem_real) +
           (size_t)pins * sizeof(sfemi_hold) + (size_t)handles * sizeof(sfemi_handle);
}

static void sfemi_state_lay_out(sfemi_state *s, void *block, sfem_int nodes, sfem_int pins)
{
    const size_t n = 3 * (size_t)nodes;
    sfem_real *at = (sfem_real *)(void *)((char *)block + sizeof(sfemi_state_head));
    int k;
    s->head = (sfemi_state_head *)block;
    s->u = at;
    s->w = at + n;
    s->a = at + 2 * n;
    for (k = 0; k < 3; ++k) s->force[k] = at + (3 + (size_t)k) * n;
    s->pin = (sfemi_hold *)(void *)(at + 6 * n);
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
    sfem_real **y;    /* [max] columns by number, [3][nodes][3] each, or NULL */
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

/* Y = A^-1 H^T of one handle. scratch [3][nodes][3] may be y itself. */
static void sfemi_grip_columns(const sfem_factor *f, const sfemi_handle *h, sfem_int nodes, sfem_real *y,
                               sfem_real *work, const sfem_exec *exec)
{
    const size_t n = 3 * (size_t)nodes;
    int k, c;
    memset(y, 0, 3 * n * sizeof *y);
    for (c = 0; c < 3; ++c)
        for (k = 0; k < 4; ++k)
            if (h->weight[k] != 0 && !(f->mask[h->node[k]] >> c & 1))
                y[(size_t)c * n + 3 * (size_t)h->node[k] + (size_t)c] += h->weight[k];
    sfemi_factor_solve(f, nodes, 3, y, y, work, exec);
}

/* Factors S = H Y and W = H M^-1 H^T over the handles in g->slot. */
static void sfemi_grip_gather(sfemi_grip *g, const sfemi_handle *handle, const sfem_model *model,
                              const unsigned char *mask)
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
                sfemi_grip_mean(hi, g->y[g->slot[j]] + (size_t)b * n, mean);
                for (a = 0; a < 3; ++a) g->s[(3 * i + a) * 3 * k + 3 * j + b] = mean[a];
                for (p = 0; p < 4; ++p)
                    for (q = 0; q < 4; ++q)
                        if (hi->node[p] == hj->node[q] && hi->weight[p] != 0 && hj->weight[q] != 0 &&
                            !(mask[hi->node[p]] >> b & 1))
                            w += hi->weight[p] * hj->weight[q] / model->node_mass[hi->node[p]];
                g->wm[(b * k + i) * k + j] = w;
            }
        }
    }
    sfemi_grip_factor(g->s, 3 * k, 3 * k);
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

/* Velocity and acceleration at the end of a step of h seconds that goes from x to hold->target: second
 * order once three positions are known. */
static void sfemi_hold_motion(const sfemi_hold *hold, const sfem_real *x, sfem_real h, sfem_real v[3],
                              sfem_real a[3])
{
    int c;
    for (c = 0; c < 3; ++c) {
        const sfem_real d = (hold->target[c] - x[c]) / h, before = (x[c] - hold->past[c]) / h;
        a[c] = hold->age > 0 ? (d - before) / h : 0;
        v[c] = d + h / 2 * a[c];
    }
}

static void sfemi_hold_advance(sfemi_hold *hold, const sfem_real *x)
{
    memcpy(hold->past, x, sizeof hold->past);
    if (hold->age < 2) ++hold->age;
}

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
    sfemi_state state;
    sfemi_grip grip;
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

/* rhs = load[0] F+ + load[1] F + load[2] F- + their sum M g - K zk - M zm - (rest of D) zd. */
static void sfemi_body_residual(sfem_body *b, const sfem_real load[3], int with_mass)
{
    const sfem_model *model = b->model;
    const size_t n = 3 * (size_t)model->mesh.nodes;
    const sfem_real all = load[0] + load[1] + load[2];
    const sfem_real *f0 = b->state.force[0], *f1 = b->state.force[1], *f2 = b->state.force[2];
    const sfem_real *g = b->def.gravity;
    size_t i;
    sfem_matrix_multiply(&model->stiffness, b->zk, b->rhs, &b->exec);
    for (i = 0; i < n / 3; ++i) {
        const sfem_real m = all * model->node_mass[i];
        b->rhs[3 * i] = m * g[0] - b->rhs[3 * i];
        b->rhs[3 * i + 1] = m * g[1] - b->rhs[3 * i + 1];
        b->rhs[3 * i + 2] = m * g[2] - b->rhs[3 * i + 2];
    }
    if (b->state.head->loaded && b->state.head->load_age >= 2)
        for (i = 0; i < n; ++i) b->rhs[i] += all * f0[i];
    else if (b->state.head->loaded)
        for (i = 0; i < n; ++i) b->rhs[i] += load[0] * f0[i] + load[1] * f1[i] + load[2] * f2[i];
    if (with_mass) sfemi_fem_add_mass(model, -1, b->zm, b->rhs);
    if (model->damping) {
        for (i = 0; i < n; ++i) b->zd[i] = -b->zd[i];
        sfemi_fem_add_damping_rest(model, b->zd, b->rhs);
    }
}

/* Solves M a = rhs on the free axes; a consistent M by conjugate gradients to rounding, with its diagonal
 * as preconditioner (its condition is below 20, whatever the mesh). Uses rhs, zk, zm as scratch. */
static void sfemi_body_mass_solve(sfem_body *b, sfem_real *a)
{
    const sfem_model *model = b->model;
    const size_t n = 3 * (size_t)model->mesh.nodes;
    sfem_real *r = b->rhs, *p = b->zk, *ap = b->zm, rz = 0, rz0;
    size_t i;
    int k;
    for (i = 0; i < n; ++i) {
        const int held = b->mask[i / 3] >> (i % 3) & 1;
        r[i] = held ? 0 : r[i];
        p[i] = held ? 0 : r[i] / model->node_mass[i / 3];
        a[i] = model->block_mass ? 0 : p[i];
        rz += r[i] * p[i];
    }
    rz0 = rz;
    for (k = 0; model->block_mass && k < 200 && rz > 1e-32 * rz0; ++k) {
        sfem_real pap = 0, step, next = 0;
        sfem_model_multiply_mass(model, p, ap, &b->exec);
        for (i = 0; i < n; ++i) pap += p[i] * ap[i];
        step = rz / pap;
        for (i = 0; i < n; ++i) {
            if (b->mask[i / 3] >> (i % 3) & 1) continue;
            a[i] += step * p[i];
            r[i] -= step * ap[i];
            next += r[i] * r[i] / model->node_mass[i / 3];
        }
        for (i = 0; i < n; ++i)
            if (!(b->mask[i / 3] >> (i % 3) & 1))
                p[i] = r[i] / model->node_mass[i / 3] + next / rz * p[i];
        rz = next;
    }
}

/* a0 = (scale M)^-1 (F - K u - D v), the acceleration at the start. */
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

/* c - (what the handles would do without force), in units of acceleration, to grip.lambda:
 * (target - H X - H u)/scale with u the displacement that is predicted. */
static void sfemi_body_handle_gap(sfem_body *b, const sfem_real *u, sfem_real scale)
{
    sfem_int i;
    int c;
    for (i = 0; i < b->grip.count; ++i) {
        const sfemi_handle *h = b->state.handle + b->grip.slot[i];
        sfem_real rest[3], moved[3];
        sfemi_grip_mean(h, b->model->mesh.x, rest);
        sfemi_grip_mean(h, u, moved);
        for (c = 0; c < 3; ++c)
            b->grip.lambda[3 * i + c] = (h->hold.target[c] - rest[c] - moved[c]) / scale;
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
        sfemi_hold_motion(b->state.pin + k, x, h, v, a);
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
    sfemi_body_handle_gap(b, b->zk, b->def.beta * h * h);
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
        sfemi_hold_motion(s->pin + k, x, h, v, a);
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
            sfemi_hold_motion(&b->state.handle[b->grip.slot[i]].hold, x + 3 * i, b->step, motion[0],
                              motion[1]);
            for (c = 0; c < 3; ++c) b->grip.lambda[3 * i + c] = motion[pass][c];
        }
        sfemi_grip_project(&b->grip, b->state.handle, b->model, b->mask, array[pass]);
    }
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
 * All are put as an equation for a = (w' - w)/h2, whose right side is a force.
 * Because positions follow from the mean velocity, a constraint on u' sets w' and leaves nothing to ring.
 * ============================================================================================ */

/* b = F's - K (cf u - ck w) - D (cd w - ca a), see above. */
typedef struct sfemi_pqr_terms {
    sfem_real cf, ck, cd, ca, load[3];
} sfemi_pqr_terms;

static int sfemi_pqr_starts_at_fourth_order(const sfem_body *b)
{
    return b->def.start == SFEM_START_FOURTH_ORDER && fabs(b->p - 1.0 / 12) < 1e-9 && b->alpha == 0 &&
           b->beta == 0 && !b->model->damping;
}

static sfemi_pqr_terms sfemi_pqr_weigh(const sfem_body *b, sfem_real h2)
{
    const sfemi_coefficients k = sfemi_body_coefficients(b, b->p);
    const sfem_real h1 = b->state.head->h;
    sfemi_pqr_terms t;
    if (b->state.head->started != SFEMI_RUNNING) {
        const int fourth = sfemi_pqr_starts_at_fourth_order(b);
        t.cf = 0.5;
        t.ck = fourth ? -h2 / 6 : -k.p * h2;
        t.cd = 0.5;
        t.ca = (0.25 - k.p) * h2;
        t.load[0] = fourth ? 1.0 / 6 : k.p;
        t.load[1] = 0.5 - t.load[0];
        t.load[2] = 0;
    } else {
        t.cf = (h1 + h2) / (2 * h2);
        t.ck = k.p * (h1 - h2) * (h1 + h2) / h2;
        t.cd = (h1 - k.q / 2 * (h1 - h2)) / h2;
        t.ca = (0.25 - k.p) * (h2 - h1) * (h2 + h1) / h2;
        t.load[0] = k.p;
        t.load[2] = k.p * h1 / h2;
        t.load[1] = t.cf - t.load[0] - t.load[2];
    }
    if (b->def.plain_load) {
        t.load[0] = t.load[2] = 0;
        t.load[1] = t.cf;
    }
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
        b->zk[i] = t.cf * s->u[i] - t.ck * s->w[i] + b->beta * dv;
        b->zm[i] = b->alpha * dv;
        if (b->zd) b->zd[i] = dv;
        b->acc[i] = 0;
    }
    for (j = 0; j < b->pin_count; ++j) { /* held axes have a given a: their columns of A go to the right */
        for (c = 0; c < 3; ++c) {
            sfem_real a;
            i = 3 * (size_t)b->pin[j] + (size_t)c;
            if (!(b->mask[b->pin[j]] >> c & 1)) continue;
            a = ((s->pin[j].target[c] - b->model->mesh.x[i] - s->u[i]) / h - s->w[i]) / h;
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
    sfemi_body_handle_gap(b, b->zk, h * h);
    sfemi_grip_apply(&b->grip, b->state.handle, b->model->mesh.nodes, b->acc);
}

static void sfemi_pqr_finish(sfem_body *b)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    const sfem_real h = b->step;
    sfemi_state *s = &b->state;
    /* w and w' are means over h1 and h: their centres lie (h1 + h)/2 apart, h/2 at the start */
    const sfem_real h1 = s->head->started == SFEMI_RUNNING ? s->head->h : 0;
    const sfem_real full = 2 * h / (h1 + h);
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
        s->w[i] += h * b->acc[i];
        s->u[i] += h * s->w[i];
        s->a[i] = full * b->acc[i];
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
    if (b->def.integrator == SFEM_CENTRAL) return 1;
    return b->def.p < 0.25 || b->def.q < 1; /* SFEM_P_AUTO is below 1/4 too */
}

/* ============================================================================================
 * >>body   the pipeline that a user calls: create, prepare, step, read
 * ============================================================================================ */

SFEM_DEF sfem_body_def sfem_default_body_def(void)
{
    sfem_body_def d;
    memset(&d, 0, sizeof d);
    d.integrator = SFEM_PQR;
    d.p = d.beta = 0.25;
    d.q = d.r = 1;
    d.gamma = 0.5;
    d.max_handles = 16;
    return d;
}

static sfem_status sfemi_body_check(const sfem_body_def *d, sfem_error *err)
{
    if ((unsigned)d->integrator > SFEM_CENTRAL)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "there is no integrator %d", (int)d->integrator);
    if (!(sfemi_finite(d->p) && (d->p >= 0 || d->p == SFEM_P_AUTO)))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "p is %g, must be >= 0 or SFEM_P_AUTO", d->p);
    if (!(sfemi_finite(d->q) && d->q >= 0)) return sfemi_fail(err, SFEM_BAD_ARGUMENT, "q is %g, must be >= 0", d->q);
    if (!(sfemi_finite(d->r) && d->r > 0)) return sfemi_fail(err, SFEM_BAD_ARGUMENT, "r is %g, must be > 0", d->r);
    if (!(sfemi_finite(d->beta) && d->beta > 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "Newmark's beta is %g, must be > 0 (central difference is an integrator of its own)", d->beta);
    if (!(sfemi_finite(d->gamma) && d->gamma >= 0.5))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "Newmark's gamma is %g, must be >= 1/2 (below, it makes energy)", d->gamma);
    if (!(sfemi_finite(d->alpha) && d->alpha >= 0 && sfemi_finite(d->beta_k) && d->beta_k >= 0))
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "Rayleigh damping (%g, %g) must be >= 0", d->alpha, d->beta_k);
    if (!sfemi_all_finite(d->gravity, 3)) return sfemi_fail(err, SFEM_NOT_FINITE, "gravity is not finite");
    if (d->max_handles < 0 || d->max_handles > 1024)
        return sfemi_fail(err, SFEM_BAD_ARGUMENT, "max_handles is %d, must be 0 to 1024", (int)d->max_handles);
    return SFEM_OK;
}

/* Which body a state block belongs to: mesh size, pins, handle capacity, and what w means. */
static uint64_t sfemi_body_key(const sfem_body *b)
{
    const int64_t shape[5] = {b->model->mesh.nodes, b->model->mesh.tets, b->pin_count, b->def.max_handles,
                              b->def.integrator == SFEM_NEWMARK};
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
        const int held = axes ? axes[i] : SFEM_AXIS_ALL;
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

static void sfemi_body_destroy(sfem_body *b)
{
    const sfem_allocator al = b->allocator;
    sfem_int i;
    sfemi_factor_release(b->model, b->factor);
    sfemi_factor_release(b->model, b->static_factor);
    for (i = 0; b->grip.y && i < b->def.max_handles; ++i) sfemi_delete(&al, b->grip.y[i]);
    sfemi_delete(&al, b->grip.y);
    sfemi_delete(&al, b->grip.slot);
    sfemi_delete(&al, b->grip.ready);
    sfemi_delete(&al, b->grip.s);
    sfemi_delete(&al, b->grip.wm);
    sfemi_delete(&al, b->grip.lambda);
    sfemi_delete(&al, b->grip.place);
    sfemi_delete(&al, b->pin);
    sfemi_delete(&al, b->mask);
    sfemi_delete(&al, b->state.head);
    sfemi_delete(&al, b->rhs);
    sfemi_delete(&al, b->work);
    sfem_model_free(b->model);
    sfemi_delete(&al, b);
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
    bytes = sfemi_state_bytes(nodes, b->pin_count, def->max_handles);
    SFEMI_NEW(char, block, al, bytes);
    sfemi_state_lay_out(&b->state, block, nodes, b->pin_count);
    sfemi_body_reset_head(b, bytes);
    SFEMI_NEW(sfem_real, b->rhs, al, vectors * n);
    b->acc = b->rhs + n;
    b->zk = b->rhs + 2 * n;
    b->zm = b->rhs + 3 * n;
    b->zd = b->model->damping ? b->rhs + 4 * n : NULL;
    if (k > 0) {
        SFEMI_NEW(sfem_int, b->grip.slot, al, k);
        SFEMI_NEW(sfem_real *, b->grip.y, al, k);
        SFEMI_NEW(sfem_int, b->grip.ready, al, k);
        SFEMI_NEW(sfem_real, b->grip.s, al, 9 * k * k);
        SFEMI_NEW(sfem_real, b->grip.wm, al, 3 * k * k);
        SFEMI_NEW(sfem_real, b->grip.lambda, al, 3 * k);
        SFEMI_NEW(sfem_real, b->grip.place, al, 3 * k);
    }
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
    sfemi_lock(&model->lock);
    ++model->references;
    sfemi_unlock(&model->lock);
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

/* Columns and dense blocks of the handles for the body's factor. */
static sfem_status sfemi_body_prepare_handles(sfem_body *b, sfem_error *err)
{
    sfemi_grip *g = &b->grip;
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    sfem_status status = SFEM_OK;
    sfem_int i, count = 0;
    if (!g->dirty) return SFEM_OK;
    for (i = 0; i < b->def.max_handles; ++i) {
        const int wanted = b->state.handle[i].used;
        if ((wanted || b->def.no_allocation) && !g->y[i])
            SFEMI_NEW(sfem_real, g->y[i], &b->allocator, 3 * n);
        count += wanted;
    }
    if (count || b->def.no_allocation) SFEMI_TRY(sfemi_body_reserve_work(b, b->factor, 3, err));
    g->count = 0;
    for (i = 0; i < b->def.max_handles; ++i) {
        if (!b->state.handle[i].used) continue;
        if (!g->ready[i])
            sfemi_grip_columns(b->factor, b->state.handle + i, b->model->mesh.nodes, g->y[i], b->work,
                               &b->exec);
        g->ready[i] = 1;
        g->slot[g->count++] = i;
    }
    sfemi_grip_gather(g, b->state.handle, b->model, b->mask);
    g->dirty = 0;
done:
    return status;
}

/* Takes over a factor that the body owns a reference to. */
static void sfemi_body_adopt(sfem_body *b, sfem_factor *f)
{
    sfem_int i;
    if (f == b->factor) {
        sfemi_factor_release(b->model, f); /* the body has one reference already */
        return;
    }
    sfemi_factor_release(b->model, b->factor);
    b->factor = f;
    for (i = 0; i < b->def.max_handles; ++i) b->grip.ready[i] = 0;
    b->grip.dirty = 1;
}

static sfem_status sfemi_body_choose_p(sfem_body *b, sfem_real h, sfem_real *p, sfem_error *err)
{
    sfem_status status = SFEM_OK;
    sfem_real limit;
    if (sfemi_pqr_needs_omega(b) && b->omega_max == 0) status = sfemi_pqr_find_omega(b, err);
    if (status != SFEM_OK) return status;
    *p = b->def.integrator == SFEM_NEWMARK    ? b->def.beta
         : b->def.integrator == SFEM_CENTRAL ? 0
                                             : b->def.p;
    if (*p == SFEM_P_AUTO) *p = b->omega_max * h < 2 ? 1.0 / 12 : 0.25;
    limit = sfemi_pqr_stable_step(b, *p);
    if (limit > 0 && h > limit)
        return sfemi_fail(err, SFEM_UNSTABLE, "a step of %g s is beyond the stable one, %g s", h, limit);
    return SFEM_OK;
}

static int sfemi_body_is_prepared(const sfem_body *b, sfem_real h)
{
    return b->factor && h == b->h && !b->grip.dirty;
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
    if (!b->factor || h != b->h) {
        status = sfemi_body_choose_p(b, h, &p, err);
        if (status != SFEM_OK) return status;
        k = sfemi_body_coefficients(b, p);
        key.ck = k.p * h * h + k.q / 2 * h * b->beta;
        key.cm = k.r + k.q / 2 * h * b->alpha;
        key.cd = b->model->damping ? k.q / 2 * h : 0;
        key.mask = b->mask;
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
        if (b->def.no_allocation)
            return sfemi_fail(err, SFEM_NOT_PREPARED, "the body is not prepared for a step of %g s", h);
        status = sfem_body_prepare(b, h, err);
        if (status != SFEM_OK) return status;
    }
    b->step = h;
    if (b->def.integrator == SFEM_NEWMARK) sfemi_newmark_predict(b, h);
    else sfemi_pqr_predict(b, h);
    b->phase = SFEMI_PREDICTED;
    return SFEM_OK;
}

SFEM_DEF sfem_status sfem_body_solve(sfem_body *b, sfem_error *err)
{
    const size_t n = 3 * (size_t)b->model->mesh.nodes;
    SFEM_ASSERT(b && b->phase == SFEMI_PREDICTED);
    sfemi_factor_solve(b->factor, b->model->mesh.nodes, 1, b->rhs, b->acc, b->work, &b->exec);
    if (b->def.integrator == SFEM_NEWMARK) sfemi_newmark_solve(b);
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
    memcpy(b->state.force[2], b->state.force[1], bytes);
    memcpy(b->state.force[1], b->state.force[0], bytes);
    ++b->state.head->load_age;
}

SFEM_DEF void sfem_body_finish(sfem_body *b)
{
    sfemi_grip *g = &b->grip;
    sfem_int i;
    SFEM_ASSERT(b && b->phase == SFEMI_SOLVED);
    for (i = 0; i < g->count; ++i) {
        memcpy(b->state.handle[g->slot[i]].force, g->lambda + 3 * i, 3 * sizeof *g->lambda);
        sfem_body_handle_position(b, g->slot[i], g->place + 3 * i);
    }
    if (b->def.integrator == SFEM_NEWMARK) {
        sfemi_newmark_finish(b);
        sfemi_newmark_settle_handles(b, g->place);
    } else {
        sfemi_pqr_finish(b);
    }
    for (i = 0; i < g->count; ++i)
        sfemi_hold_advance(&b->state.handle[g->slot[i]].hold, g->place + 3 * i);
    sfemi_body_age_load(b);
    b->state.head->started = SFEMI_RUNNING;
    b->state.head->time += b->step;
    b->state.head->h = b->step;
    b->phase = SFEMI_IDLE;
}

SFEM_DEF sfem_status sfem_body_step(sfem_body *b, sfem_real h, sfem_error *err)
{
    sfem_status status = sfem_body_predict(b, h, err);
    if (status == SFEM_OK) status = sfem_body_solve(b, err);
    if (status == SFEM_OK) sfem_body_finish(b);
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
    memcpy(b->def.gravity, g, sizeof b->def.gravity);
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
    const int mean = b->def.integrator != SFEM_NEWMARK && s->head->started == SFEMI_RUNNING;
    const sfem_real half = mean ? s->head->h / 2 : 0;
    size_t i;
    for (i = 0; i < 3 * (size_t)b->model->mesh.nodes; ++i) v[i] = s->w[i] + half * s->a[i];
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
    sfem_int i;
    if (bytes < sizeof head) return sfemi_fail(err, SFEM_FORMAT, "a state of %lu bytes is cut short", (unsigned long)bytes);
    memcpy(&head, memory, sizeof head);
    if (memcmp(head.magic, "sfemstat", 8) != 0) return sfemi_fail(err, SFEM_FORMAT, "this is no saved state");
    if (head.version != 1)
        return sfemi_fail(err, SFEM_FORMAT, "the state has version %u, this library reads 1", (unsigned)head.version);
    if (head.size != bytes || head.checksum != sfemi_state_checksum(memory, bytes))
        return sfemi_fail(err, SFEM_FORMAT, "the saved state is damaged");
    if (head.size != b->state.head->size || head.key != b->state.head->key)
        return sfemi_fail(err, SFEM_MISMATCH, "the state is of a body with another mesh, pins or handles");
    memcpy(b->state.head, memory, bytes);
    b->state.head->checksum = 0;
    for (i = 0; i < b->def.max_handles; ++i) b->grip.ready[i] = 0;
    b->grip.dirty = 1;
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
    sfem_int *list = NULL, listed, i;
    void *block = NULL;
    size_t bytes;
    sfem_status status = SFEM_OK;
    SFEMI_NEW(unsigned char, mask, al, nodes);
    SFEMI_NEW(sfem_int, list, al, count > 0 ? count : 1);
    SFEMI_TRY(sfemi_body_collect_pins(b, count, pins, axes, mask, list, &listed, err));
    bytes = sfemi_state_bytes(nodes, listed, b->def.max_handles);
    SFEMI_NEW(char, block, al, bytes);
    sfemi_state_lay_out(&fresh, block, nodes, listed);
    memcpy(fresh.head, old.head, sizeof *old.head + 18 * (size_t)nodes * sizeof(sfem_real));
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
    sfemi_factor_release(b->model, b->factor);
    b->factor = NULL;
    for (i = 0; i < b->def.max_handles; ++i) b->grip.ready[i] = 0;
    b->grip.dirty = 1;
    sfemi_body_place_pins(b);
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
        return sfemi_fail_at(err, SFEM_BAD_ARGUMENT, node[0], -1, "node %d is pinned on all axes", (int)node[0]);
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
    b->grip.ready[handle] = 0;
    b->grip.dirty = 1;
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
    for (i = 0; i < n; ++i) {
        b->zk[i] = b->state.u[i] + b->beta * v[i];
        b->zm[i] = b->state.a[i] + b->alpha * v[i];
        if (b->zd) b->zd[i] = v[i];
    }
    b->phase = SFEMI_IDLE;
    sfemi_body_residual(b, load, inertia || b->state.head->started == SFEMI_RUNNING);
    for (i = 0; i < n; ++i) force[i] = b->mask[i / 3] >> (i % 3) & 1 ? -b->rhs[i] : 0;
}

/* ---- statics ---- */

/* The body's pins and its node handles: what a static solution has to hold. */
static void sfemi_body_static_mask(const sfem_body *b, unsigned char *mask)
{
    sfem_int k;
    memcpy(mask, b->mask, (size_t)b->model->mesh.nodes);
    for (k = 0; k < b->def.max_handles; ++k)
        if (b->state.handle[k].used && b->state.handle[k].weight[0] == 1)
            mask[b->state.handle[k].node[0]] = SFEM_AXIS_ALL;
}

/* Known displacements to u, zero elsewhere. */
static void sfemi_body_static_known(const sfem_body *b, sfem_real *u)
{
    const sfem_real *rest = b->model->mesh.x;
    sfem_int k;
    int c;
    memset(u, 0, 3 * (size_t)b->model->mesh.nodes * sizeof *u);
    for (k = 0; k < b->def.max_handles; ++k) {
        const sfemi_handle *h = b->state.handle + k;
        const size_t at = 3 * (size_t)h->node[0];
        for (c = 0; h->used && h->weight[0] == 1 && c < 3; ++c)
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
        if (!h->used || h->weight[0] == 1) continue;
        if (!g->y[k]) SFEMI_NEW(sfem_real, g->y[k], &b->allocator, 9 * (size_t)b->model->mesh.nodes);
        if (apply) sfemi_grip_columns(f, h, b->model->mesh.nodes, g->y[k], b->work, &b->exec);
        g->slot[g->count++] = k;
    }
    if (apply && g->count) {
        sfemi_grip_gather(g, b->state.handle, b->model, f->mask);
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

/* The forces of node handles: what is out of balance there. */
static void sfemi_body_static_forces(sfem_body *b)
{
    const sfem_real load[3] = {1, 0, 0};
    sfem_int k;
    int c;
    memcpy(b->zk, b->state.u, 3 * (size_t)b->model->mesh.nodes * sizeof *b->zk);
    if (b->zd) memset(b->zd, 0, 3 * (size_t)b->model->mesh.nodes * sizeof *b->zd);
    sfemi_body_residual(b, load, 0);
    for (k = 0; k < b->def.max_handles; ++k) {
        sfemi_handle *h = b->state.handle + k;
        for (c = 0; h->used && h->weight[0] == 1 && c < 3; ++c)
            h->force[c] = b->mask[h->node[0]] >> c & 1 ? 0 : -b->rhs[3 * (size_t)h->node[0] + (size_t)c];
    }
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
    SFEMI_TRY(sfemi_factor_get(b->model, &key, &b->exec, &f, &b->factors_made, err));
    SFEMI_TRY(sfemi_body_reserve_work(b, f, 3, err));
    SFEMI_TRY(sfemi_body_static_handles(b, f, NULL, 0, err));
    sfemi_body_static_known(b, b->zk);
    memcpy(b->acc, b->zk, n * sizeof *b->acc);
    if (b->zd) memset(b->zd, 0, n * sizeof *b->zd);
    sfemi_body_residual(b, load, 0);
    sfemi_factor_solve(f, b->model->mesh.nodes, 1, b->rhs, b->acc, b->work, &b->exec);
    SFEMI_TRY(sfemi_body_static_handles(b, f, b->acc, 1, err));
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
    sfem_model_multiply_stiffness(model, s->u, b->zk, &b->exec);
    e.elastic = sfemi_body_dot(s->u, b->zk, n) / 2;
    e.load = 0;
    for (i = 0; i < n; ++i)
        e.load -= s->u[i] * (force[i] + model->node_mass[i / 3] * b->def.gravity[i % 3]);
    e.total = e.conserved = e.kinetic + e.elastic + e.load;
    if (!running) return e;
    if (b->def.integrator == SFEM_NEWMARK) {
        sfem_model_multiply_mass(model, s->a, b->zm, &b->exec);
        e.conserved += (b->def.beta - 0.25) * h * h / 2 * sfemi_body_dot(s->a, b->zm, n);
    } else {
        const sfemi_coefficients k = sfemi_body_coefficients(b, b->p);
        sfem_real wkw, load_w = 0;
        sfem_model_multiply_mass(model, s->w, b->zm, &b->exec);
        sfem_model_multiply_stiffness(model, s->w, b->rhs, &b->exec);
        wkw = sfemi_body_dot(s->w, b->rhs, n);
        for (i = 0; i < n; ++i)
            load_w += s->w[i] * (force[i] + model->node_mass[i / 3] * b->def.gravity[i % 3]);
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
    memset(&info, 0, sizeof info);
    info.nodes = b->model->mesh.nodes;
    info.tets = b->model->mesh.tets;
    for (i = 0; i < info.nodes; ++i) info.free_nodes += b->mask[i] != SFEM_AXIS_ALL;
    info.p = b->factor ? b->p : 0;
    info.omega_max = b->omega_max;
    info.factors_made = b->factors_made;
    info.body_bytes = (size_t)b->state.head->size + ((b->zd ? 5 : 4) * n + b->work_size) * sizeof(sfem_real);
    for (i = 0; i < b->def.max_handles; ++i)
        if (b->grip.y[i]) info.body_bytes += 3 * n * sizeof(sfem_real);
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
