/* elastic.h - what examples compute from softfem.h's bodies. Include after support.h and softfem.h.
 *
 *     ex_node_stress(model, mesh, x)   von Mises stress at the nodes of a body at x
 */
#ifndef SFEM_EXAMPLES_ELASTIC_H
#define SFEM_EXAMPLES_ELASTIC_H

/* [tets], Pa; to be freed. */
EX_STATIC double *ex_tet_stress(const sfem_model *model, const sfem_mesh *mesh, const double *x)
{
    double *u = (double *)ex_new(3 * (size_t)mesh->nodes, sizeof *u);
    double *stress = (double *)ex_new((size_t)mesh->tets, sizeof *stress);
    sfem_int i;
    for (i = 0; i < 3 * mesh->nodes; ++i) u[i] = x[i] - mesh->x[i];
    sfem_model_stress(model, u, NULL, stress);
    free(u);
    return stress;
}

/* [nodes], the mean over their tets by volume; to be freed. */
EX_STATIC double *ex_node_stress(const sfem_model *model, const sfem_mesh *mesh, const double *x)
{
    const double *volume = sfem_model_tet_volume(model);
    double *stress = ex_tet_stress(model, mesh, x);
    double *node = (double *)ex_new((size_t)mesh->nodes, sizeof *node);
    double *weight = (double *)ex_new((size_t)mesh->nodes, sizeof *weight);
    sfem_int i;
    for (i = 0; i < 4 * mesh->tets; ++i) {
        node[mesh->tet[i]] += volume[i / 4] * stress[i / 4];
        weight[mesh->tet[i]] += volume[i / 4];
    }
    for (i = 0; i < mesh->nodes; ++i) node[i] = weight[i] > 0 ? node[i] / weight[i] : 0;
    free(weight);
    free(stress);
    return node;
}

#endif
