/* interop_dump - what a mesh file holds, as JSON: tests/interop.py compares it with what other programs say.
 *
 *     interop_dump FILE [--linear] [--weld DISTANCE] [--surface]
 *
 * {"x": [[x, y, z], ..], "tets": [[a, b, c, d], ..], "region": [..], "regions": {name: number}, "sets": {name: ["nodes" or
 * "tets", [..]]}, "info": {..}}; of a surface "x" and "triangles". What cannot be read gives {"error": text} and exit 1. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "softfem.h"

static void rows(const char *name, sfem_int count, int columns, const sfem_int *v)
{
    sfem_int i;
    int c;
    printf("\"%s\":[", name);
    for (i = 0; i < count; ++i)
        for (c = 0; c < columns; ++c)
            printf("%s%ld%s", c ? "," : i ? ",[" : "[", (long)v[(size_t)i * (size_t)columns + (size_t)c], c + 1 < columns ? "" : "]");
    printf("],\n");
}

static void list(sfem_int count, const sfem_int *v)
{
    sfem_int i;
    printf("[");
    for (i = 0; i < count; ++i) printf("%s%ld", i ? "," : "", (long)v[i]);
    printf("]");
}

static void points(sfem_int count, const sfem_real *x)
{
    sfem_int i;
    printf("{\"x\":[");
    for (i = 0; i < count; ++i) printf("%s[%.17g,%.17g,%.17g]", i ? "," : "", x[3 * i], x[3 * i + 1], x[3 * i + 2]);
    printf("],\n");
}

static void text(const char *s)
{
    putchar('"');
    for (; *s; ++s) {
        if (*s == '"' || *s == '\\') putchar('\\');
        putchar(*s);
    }
    putchar('"');
}

static int refuse(const sfem_error *err)
{
    printf("{\"error\":");
    text(err->text);
    printf("}\n");
    return 1;
}

static int dump_surface(const char *path)
{
    sfem_surface s;
    sfem_error err;
    if (sfem_surface_read(path, NULL, &s, &err) != SFEM_OK) return refuse(&err);
    points(s.nodes, s.x);
    rows("triangles", s.triangles, 3, s.tri);
    printf("\"region\":[]}\n");
    sfem_surface_free(&s);
    return 0;
}

static int dump_mesh(const char *path, const sfem_mesh_read_def *def)
{
    sfem_mesh m;
    sfem_mesh_sets s;
    sfem_mesh_read_info info;
    sfem_error err;
    sfem_int i;
    if (sfem_mesh_read_sets(path, def, &m, &s, &info, &err) != SFEM_OK) return refuse(&err);
    points(m.nodes, m.x);
    rows("tets", m.tets, 4, m.tet);
    printf("\"region\":");
    list(m.region ? m.tets : 0, m.region);
    printf(",\n\"regions\":[");
    for (i = 0; i < s.regions; ++i) {
        const sfem_region *r = s.region + i;
        printf("%s{\"name\":", i ? "," : "");
        text(r->name);
        printf(",\"material\":");
        text(r->material);
        printf(",\"number\":%ld,\"tets\":%ld,\"elastic\":%d,\"E\":%.17g,\"nu\":%.17g,\"rho\":%.17g}", (long)r->number,
               (long)r->tets, r->has_elastic, r->young, r->poisson, r->density);
    }
    printf("],\n\"sets\":{");
    for (i = 0; i < s.sets; ++i) {
        char name[300];
        snprintf(name, sizeof name, "%s %s", s.set[i].of_tets ? "tets" : "nodes", s.set[i].name);
        printf("%s", i ? ",\n" : "");
        text(name);
        printf(":");
        list(s.set[i].count, s.set[i].member);
    }
    printf("},\n\"info\":{\"swapped\":%ld,\"linear\":%ld,\"removed\":%ld,\"welded\":%ld,\"triangles\":%ld,\"others\":%ld}}\n",
           (long)info.swapped, (long)info.linear, (long)info.removed, (long)info.welded, (long)info.triangles,
           (long)info.others);
    sfem_mesh_sets_free(&s);
    sfem_mesh_free(&m);
    return 0;
}

int main(int argc, char **argv)
{
    sfem_mesh_read_def def = sfem_default_mesh_read_def();
    int i, surface = 0;
    if (argc < 2) return fprintf(stderr, "interop_dump FILE [--linear] [--weld DISTANCE] [--surface]\n"), 2;
    for (i = 2; i < argc; ++i) {
        if (!strcmp(argv[i], "--linear")) def.linear = 1;
        if (!strcmp(argv[i], "--surface")) surface = 1;
        if (!strcmp(argv[i], "--weld") && i + 1 < argc) def.weld = 1, def.weld_distance = atof(argv[i + 1]);
    }
    return surface ? dump_surface(argv[1]) : dump_mesh(argv[1], &def);
}
