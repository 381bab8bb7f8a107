/* elastic.h - what examples compute from softfem.h's meshes. Include after support.h and softfem.h.
 *
 *     ex_strain_stress(mesh, x, turns, mu, out)   von Mises stress at the nodes of a body at x
 */
#ifndef SFEM_EXAMPLES_ELASTIC_H
#define SFEM_EXAMPLES_ELASTIC_H

/* F = dx/dX of a tet, row-major; returns its volume at rest. */
EX_STATIC double ex_deformation(const sfem_mesh *mesh, sfem_int tet, const double *x, double f[9])
{
    const sfem_int *t = mesh->tet + 4 * (size_t)tet;
    double rest[9], now[9], inverse[9], det = 0;
    int i, j, k;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j) { /* columns: the edges from node 0 */
            rest[3 * i + j] = mesh->x[3 * t[j + 1] + i] - mesh->x[3 * t[0] + i];
            now[3 * i + j] = x[3 * t[j + 1] + i] - x[3 * t[0] + i];
        }
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j) {
            const int a = (i + 1) % 3, b = (i + 2) % 3, c = (j + 1) % 3, d = (j + 2) % 3;
            inverse[3 * j + i] = rest[3 * a + c] * rest[3 * b + d] - rest[3 * a + d] * rest[3 * b + c];
        }
    for (i = 0; i < 3; ++i) det += rest[i] * inverse[3 * i];
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j)
            for (f[3 * i + j] = 0, k = 0; k < 3; ++k) f[3 * i + j] += now[3 * i + k] * inverse[3 * k + j] / det;
    return det / 6;
}

/* von Mises stress of a tet of a body at x, by the stretch of its polar decomposition where it turns */
EX_STATIC double ex_tet_stress(const sfem_mesh *mesh, sfem_int tet, const double *x, int turns, double mu,
                               double *volume)
{
    double f[9], r[9], s[9], size = 0, mean;
    int k;
    *volume = ex_deformation(mesh, tet, x, f);
    if (turns) sfem_polar(f, r, s);
    else for (k = 0; k < 9; ++k) s[k] = (f[k] + f[k % 3 * 3 + k / 3]) / 2;
    mean = (s[0] + s[4] + s[8]) / 3;
    for (k = 0; k < 9; ++k) size += (s[k] - (k % 4 ? 0 : mean)) * (s[k] - (k % 4 ? 0 : mean));
    return sqrt(1.5 * size) * 2 * mu;
}

/* Von Mises stress sqrt(3/2) |2 mu dev e| at the nodes, the mean over their tets by volume: e is F's
 * stretch less I where the body turns, else the small strain. To be freed. */
EX_STATIC double *ex_strain_stress(const sfem_mesh *mesh, const double *x, int turns, double mu)
{
    double *node = (double *)ex_new((size_t)mesh->nodes, sizeof *node);
    double *weight = (double *)ex_new((size_t)mesh->nodes, sizeof *weight);
    sfem_int e, i;
    int k;
    for (e = 0; e < mesh->tets; ++e) {
        double volume;
        const double stress = ex_tet_stress(mesh, e, x, turns, mu, &volume);
        for (k = 0; k < 4; ++k) {
            node[mesh->tet[4 * e + k]] += volume * stress;
            weight[mesh->tet[4 * e + k]] += volume;
        }
    }
    for (i = 0; i < mesh->nodes; ++i) node[i] = weight[i] > 0 ? node[i] / weight[i] : 0;
    free(weight);
    return node;
}

#endif
