/* page.h - what page.c and the softfem.h beside it are compiled with: portable kernels, functions in place of libm's, and
 * the parts that the page uses. */
#ifndef SFEM_EXAMPLES_PAGE_H
#define SFEM_EXAMPLES_PAGE_H

#include "portable_math.h"

#ifdef __wasm__
__attribute__((import_module("page"), import_name("failed"))) void page_failed(const char *text);
#define SFEM_ASSERT(x) ((x) ? (void)0 : (page_failed("softfem.h: " #x), __builtin_trap()))
#define EXPORT(name) __attribute__((export_name(#name)))
#define SFEM_NO_STDIO
#else
#define EXPORT(name) static
#endif
#define SFEM_NO_DISPATCH
#define SFEM_MINIMAL
#define SFEM_ENABLE_MESHIO
#define SFEM_ENABLE_MESHER
#define SFEM_ENABLE_EMBED
#define SFEM_ENABLE_DAMAGE
#define SFEM_ENABLE_CONTACT
#define SFEM_ENABLE_MODES
#define SFEM_ENABLE_REDUCED

#endif
