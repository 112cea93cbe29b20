"""Photonfarm in Blender: a render engine, and jobs on a farm."""

import bpy

from . import engine, operators, panels

CLASSES = (engine.PhotonfarmEngine, *operators.CLASSES)


def register():
    panels.register()
    for known in CLASSES:
        bpy.utils.register_class(known)


def unregister():
    for known in reversed(CLASSES):
        bpy.utils.unregister_class(known)
    panels.unregister()
