/* The tests of the solver once more, with the kernels that every processor can run. */
#define SFEM_STATIC
#define SFEM_MINIMAL
#define SFEM_ENABLE_MODEL
#define SFEM_ENABLE_MESHIO
#define SFEM_NO_DISPATCH
#define SOFTFEM_IMPLEMENTATION
#include "test_solver.c"
