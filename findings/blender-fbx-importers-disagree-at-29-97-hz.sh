#!/usr/bin/env bash
# Blender's two FBX importers place the same keys at different frames at 29.97 Hz.
#
# Guess: keys at frames 1 to 301 of a scene at 30 / 1.001 frames a second come back at 1 to 301, whichever importer
# opens Blender's own export, because both give the scene the file's frame rate.
# Seen: the add-on (import_scene.fbx) multiplies seconds by the whole number of frames a second and ignores fps_base,
# though it sets it: the last key lies at 301.300, 1.8 frames a minute late. The built-in importer (wm.fbx_import) has
# 301. At 25 Hz both agree.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check bpy==5.0.1
cat > "$folder/keys.py" <<'PY'
import sys

import bpy


def last_keys(fps, fps_base, path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = fps, fps_base
    scene.frame_start, scene.frame_end = 1, 301
    thing = bpy.data.objects.new("thing", None)
    scene.collection.objects.link(thing)
    for frame, place in ((1, 0.0), (301, 3.0)):
        thing.location.x = place
        thing.keyframe_insert("location", frame=frame)
    bpy.ops.export_scene.fbx(filepath=path, object_types={"EMPTY"}, bake_anim_use_nla_strips=False)
    found = []
    for load in (bpy.ops.import_scene.fbx, bpy.ops.wm.fbx_import):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        load(filepath=path)
        (action,) = bpy.data.actions
        render = bpy.context.scene.render
        found.append(action.curve_frame_range[1])
        print(load.idname(), "scene", render.fps, "/", round(render.fps_base, 6), "last key at", round(found[-1], 4))
    return found


print("bpy", bpy.app.version_string)
whole = last_keys(25, 1.0, sys.argv[1])
ntsc = last_keys(30, 1.001, sys.argv[1])
as_seen = abs(whole[0] - whole[1]) < 1e-3 and abs(ntsc[0] - 301.3) < 0.01 and abs(ntsc[1] - 301.0) < 0.01
print("as seen" if as_seen else "the behaviour has changed")
sys.exit(not as_seen)
PY
"$folder/venv/bin/python" "$folder/keys.py" "$folder/keys.fbx"
