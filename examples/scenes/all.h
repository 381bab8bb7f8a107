/* all.h - the list of all scenes. A new one: its header, and its line here. */
#ifndef SFEM_EXAMPLES_SCENES_ALL_H
#define SFEM_EXAMPLES_SCENES_ALL_H

#include "scene.h"
#include "shapes.h"
#include "grab.h"
#include "cut.h"
#include "tear.h"
#include "drop.h"
#include "gripper.h"
#include "jelly.h"
#include "twist.h"
#include "shatter.h"
#include "modes.h"
#include "mesh.h"

static const sc_scene *const sc_scenes[] = {
    &sc_scene_grab, &sc_scene_cut, &sc_scene_tear, &sc_scene_jelly, &sc_scene_twist, &sc_scene_shatter,
#ifndef SFEM_NO_CONTACT
    &sc_scene_drop, &sc_scene_gripper,
#endif
#ifndef SFEM_NO_MODES
    &sc_scene_modes,
#endif
#ifndef SFEM_NO_MESHIO
    &sc_scene_mesh, /* the last one: page.c relies on that */
#endif
};
enum { SC_SCENES = (int)(sizeof sc_scenes / sizeof *sc_scenes) };

/* The scene of that name, or NULL. */
SC_STATIC const sc_scene *sc_find(const char *name)
{
    int k;
    for (k = 0; k < SC_SCENES; ++k)
        if (!strcmp(sc_scenes[k]->name, name)) return sc_scenes[k];
    return NULL;
}

#endif
