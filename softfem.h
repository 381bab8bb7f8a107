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

/* ============================================================================================
 * >>meshio   readers and writers
 * ============================================================================================ */

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
