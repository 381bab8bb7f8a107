/* Blocks whose nodes are moved a little, so that no symmetry hides a mistake: what most tests and benches of bodies step.
 * To be included after softfem.h. */
#ifndef TESTS_BLOCKS_H
#define TESTS_BLOCKS_H

static inline double block_uniform(uint64_t *random, double low, double high) /* splitmix64 [Steele, Lea, Flood 2014] */
{
    uint64_t z = (*random += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return low + (high - low) * ((double)((z ^ (z >> 31)) >> 11) / 9007199254740992.0);
}

static inline void block_jitter(sfem_mesh *mesh, double by, uint64_t *random)
{
    sfem_int i;
    for (i = 0; i < 3 * mesh->nodes; ++i) mesh->x[i] += block_uniform(random, -by, by);
}

/* Of five tets a cell. *random: the seed, and the state after it. */
static inline sfem_status block_mesh(const sfem_int cells[3], const sfem_real size[3], double jitter, uint64_t *random,
                                     sfem_mesh *mesh, sfem_error *err)
{
    const sfem_status status = sfem_mesh_block(cells, size, SFEM_CELL_5_TETS, NULL, mesh, err);
    if (status == SFEM_OK) block_jitter(mesh, jitter, random);
    return status;
}

/* The nodes of its face x = 0, which come first: how many there are. */
static inline sfem_int block_clamp(const sfem_int cells[3], sfem_int *pins)
{
    const sfem_int count = (cells[1] + 1) * (cells[2] + 1);
    sfem_int i;
    for (i = 0; i < count; ++i) pins[i] = i;
    return count;
}

#endif
