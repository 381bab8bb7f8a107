#include <stdio.h>
#define SOFTFEM_IMPLEMENTATION
#include "softfem.h"

int main(void) /* a rubber bar of half a metre, clamped at one end, swings for a second */
{
    const sfem_int cells[3] = {10, 2, 2}, pins[9] = {0, 1, 2, 3, 4, 5, 6, 7, 8};
    const sfem_real size[3] = {0.5, 0.1, 0.1};
    sfem_model_def model_def = sfem_default_model_def(); /* 1 MPa, 0.3, 1000 kg/m^3, corotational */
    sfem_body_def def = sfem_default_body_def();
    sfem_mesh mesh; sfem_model *model; sfem_body *body; sfem_error err; int i, failed;
    model_def.mesh = &mesh, def.pins = pins, def.pin_count = 9, def.gravity[2] = -9.81;
    failed = sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err) ||
             sfem_model_create(&model_def, &model, &err) || sfem_body_create(model, &def, &body, &err);
    for (i = 0; !failed && i < 60; ++i) failed = sfem_body_step(body, 1 / 60.0, &err) != SFEM_OK;
    if (failed) return printf("%s\n", err.text), 1;
    return printf("tip at %.4f m\n", sfem_body_displacement(body)[3 * mesh.nodes - 1]) < 0;
}
