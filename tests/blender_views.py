"""Renders, in Blender, what a latlong file looks like as the world: python blender_views.py IN OUT.

Needs the package bpy. OUT is a NumPy file of six views (6, 24, 24, 3) from the origin with a
field of view of 90 degrees, +X -X +Y -Y +Z -Z of Blender's world in turn; row 0 at the top.
"""

import math
import sys

import bpy
import mathutils
import numpy as np

VIEWS = [  # where each looks, and what is up; Blender's world has +Z up
    ((1, 0, 0), (0, 0, 1)),
    ((-1, 0, 0), (0, 0, 1)),
    ((0, 1, 0), (0, 0, 1)),
    ((0, -1, 0), (0, 0, 1)),
    ((0, 0, 1), (0, 1, 0)),
    ((0, 0, -1), (0, 1, 0)),
]
SIZE = 24


def main(source: str, out: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 64
    scene.cycles.use_denoising = False
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    world = bpy.data.worlds.new("world")
    scene.world = world
    world.use_nodes = True
    texture = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(source)
    background = world.node_tree.nodes["Background"]
    world.node_tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    camera = bpy.data.cameras.new("camera")
    camera.angle = math.pi / 2
    thing = bpy.data.objects.new("camera", camera)
    scene.collection.objects.link(thing)
    scene.camera = thing
    views = []
    for k, (towards, up) in enumerate(VIEWS):
        back, above = -mathutils.Vector(towards), mathutils.Vector(up)
        right = above.cross(back)
        thing.matrix_world = mathutils.Matrix((right, above, back)).transposed().to_4x4()
        scene.render.filepath = f"{out}.{k}.exr"
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        image.colorspace_settings.name = "Non-Color"
        pixels = np.array(image.pixels[:], np.float32).reshape(SIZE, SIZE, -1)
        views.append(pixels[::-1, :, :3])
    np.save(out, np.stack(views))


main(*sys.argv[-2:])
