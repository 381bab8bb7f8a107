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
 *            >>kernels      inner loops, compiled once for each vector path
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

/* A mesh owns its arrays; sfem_mesh_free releases them. A mesh may also point at the caller's arrays
 * (fill the fields, do not free it). A tet a b c d is right-handed: (b-a)x(c-a).(d-a) > 0. */
typedef struct sfem_mesh {
    sfem_int nodes, tets;
    sfem_real *x;     /* [nodes][3] rest positions, m */
    sfem_int *tet;    /* [tets][4]  node numbers, from 0 */
    sfem_int *region; /* [tets]     the file's region or physical group, or NULL */
    sfem_allocator allocator;
} sfem_mesh;

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

/* ============================================================================================
 * >>meshio   readers and writers
 * ============================================================================================ */

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
     sfemi_ldl_forward8_64_##p, sfemi_ldl_backward8_64_##p, sfemi_ldl_invert_32_##p,               \
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
                          backward_, forward8_, backward8_)                                        \
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
            (q->block == 1 ? y->kernels->forward_ : y->kernels->forward8_)(                        \
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
            (q->block == 1 ? y->kernels->backward_ : y->kernels->backward8_)(                      \
                k, f, y->panel_[s + 1] - y->panel_[s], q->ldl->l_ + y->panel_[s],                  \
                w + n * (size_t)y->first[s], y->target + y->start[s], w, scratch);                 \
        }                                                                                          \
    }

SFEMI_SOLVE_TASKS(double, sfemi_solve_forward, sfemi_solve_backward, w, scratch, l, panel, forward,
                  backward, forward8, backward8)
SFEMI_SOLVE_TASKS(float, sfemi_solve_forward32, sfemi_solve_backward32, w32, scratch32, l32,
                  panel32, forward32, backward32, forward8_32, backward8_32)
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

static void sfemi_dense_solve(sfem_int n, const sfem_real *a, sfem_int rhs, sfem_real *x, int unit)
{
    const sfemi_ldl_kernels *k = sfemi_ldl_kernels_of(sfemi_path());
    const size_t m = (size_t)n;
    size_t i, j, end;
    for (; rhs > 0; --rhs, x += m) {
        for (j = 0; j < m; j = end) { /* eight columns, then what they do to the rows below */
            size_t p;
            end = j + 8 < m ? j + 8 : m;
            for (p = j; p < end; ++p) {
                if (!unit) x[p] /= a[p * (m + 1)];
                for (i = p + 1; i < end; ++i) x[i] -= a[i + p * m] * x[p];
            }
            if (end < m) k->dense_minus(m - end, a + end + j * m, m, x + j, x + end);
        }
        if (unit)
            for (j = 0; j < m; ++j) x[j] /= a[j * (m + 1)];
        for (end = m; end > 0; end = j) { /* four columns, from the last */
            double dot[4] = {0, 0, 0, 0};
            size_t p;
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
}

SFEM_DEF void sfem_dense_cholesky_solve(sfem_int n, const sfem_real *a, sfem_int rhs, sfem_real *x)
{
    sfemi_dense_solve(n, a, rhs, x, 0);
}

SFEM_DEF void sfem_dense_ldl_solve(sfem_int n, const sfem_real *a, sfem_int rhs, sfem_real *x)
{
    sfemi_dense_solve(n, a, rhs, x, 1);
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
#define SFEMI_LANES(name, arguments, expression)                                                   \
    static SFEMI_INLINE SFEMI_V SFEMI_KERNEL(name) arguments                                       \
    {                                                                                              \
        SFEMI_V r;                                                                                 \
        int i;                                                                                     \
        for (i = 0; i < SFEMI_W; ++i) r.e[i] = (expression);                                       \
        return r;                                                                                  \
    }
SFEMI_LANES(sfemi_v_load, (const SFEMI_R *p), p[i])
SFEMI_LANES(sfemi_v_dup, (SFEMI_R s), s)
SFEMI_LANES(sfemi_v_add, (SFEMI_V a, SFEMI_V b), a.e[i] + b.e[i])
SFEMI_LANES(sfemi_v_mul, (SFEMI_V a, SFEMI_V b), a.e[i] * b.e[i])
SFEMI_LANES(sfemi_v_fma, (SFEMI_V a, SFEMI_V b, SFEMI_V c), SFEMI_FMA1(a.e[i], b.e[i], c.e[i]))
SFEMI_LANES(sfemi_v_fnma, (SFEMI_V a, SFEMI_V b, SFEMI_V c), SFEMI_FMA1(-a.e[i], b.e[i], c.e[i]))
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
