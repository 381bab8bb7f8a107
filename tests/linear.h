/* Small-strain definitions, for tests and benches of what is linear: the library's own default is corotational.
 * To be included after softfem.h. */
#ifndef TESTS_LINEAR_H
#define TESTS_LINEAR_H

static inline sfem_material linear_material(void)
{
    sfem_material m = sfem_default_material();
    m.law = SFEM_LINEAR;
    return m;
}

static inline sfem_model_def linear_model_def(void)
{
    sfem_model_def d = sfem_default_model_def();
    d.material.law = SFEM_LINEAR;
    return d;
}

#endif
