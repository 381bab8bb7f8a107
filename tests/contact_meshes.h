/* contact_meshes.h - blocks and balls, for the tests of contact. After support.h. */
#ifndef SFEM_TESTS_CONTACT_MESHES_H
#define SFEM_TESTS_CONTACT_MESHES_H

TEST_STATIC void shift(sfem_mesh *mesh, double dx, double dy, double dz)
{
    sfem_int i;
    for (i = 0; i < mesh->nodes; ++i) {
        mesh->x[3 * i] += dx;
        mesh->x[3 * i + 1] += dy;
        mesh->x[3 * i + 2] += dz;
    }
}

TEST_STATIC sfem_mesh block(sfem_int n, double side)
{
    const sfem_int cells[3] = {n, n, n};
    const sfem_real size[3] = {side, side, side};
    sfem_mesh mesh;
    sfem_error err;
    assert_ok(sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, &mesh, &err), err);
    return mesh;
}

TEST_STATIC sfem_mesh ball(double radius, sfem_int rings)
{
    sfem_mesh mesh;
    sfem_error err;
    assert_ok(sfem_mesh_ball(radius, rings, NULL, &mesh, &err), err);
    return mesh;
}

#endif
