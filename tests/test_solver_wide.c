/* The tests of the solver once more, with the tiles and vectors of AVX-512, on processors that only
 * have AVX2: what the intrinsics would do is done in plain C. */
#define SFEM_STATIC
#define SFEM_MINIMAL
#define SFEM_ENABLE_MODEL
#define SFEM_ENABLE_MESHIO
#define SFEM_FORCE_PATH 2
#define SFEMI_EMULATE_AVX512
#define SOFTFEM_IMPLEMENTATION
#if defined(__x86_64__) && defined(__GNUC__)
#define main solver_main
#include "test_solver.c"
#undef main
int main(void)
{
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) return 0;
    return solver_main();
}
#else
int main(void) { return 0; }
#endif
