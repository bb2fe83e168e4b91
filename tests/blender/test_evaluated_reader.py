"""What a viewport reads again: as much as a fresh reading would find, and of that only what has changed."""

import numpy as np
import pytest

from f4x_core.scene import write_scene
from f4x_core.scene.tints import with_tints

from .artist import perform
from .tiny_scene import tiny_scene

SCRIPT = """
from feature4x.addon.render import evaluated
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))
bpy.ops.mesh.primitive_cube_add(size=0.1)
cube, scene = bpy.context.object, bpy.context.scene
still, moving = (next(o for o in scene.objects if o.type == "POINTCLOUD" and word in o.name) for word in ("static", "dynamic"))
reader, before, told = evaluated.Reader(), {}, {}
PARTS = ("means", "quats", "scales", "opacities", "sh", "turn", "to_world")

def read(*_):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    clouds, surfaces = reader.stage(depsgraph)
    fresh, walls = evaluated.stage(depsgraph)
    assert len(clouds) == len(fresh) and len(surfaces) == len(walls), told
    same = [np.array_equal(getattr(a, part), getattr(b, part)) for a, b in zip(clouds, fresh) for part in PARTS]
    same += [np.array_equal(a.triangles, b.triangles) for a, b in zip(surfaces, walls)]
    same += [np.array_equal(a.colors, b.colors) for a, b in zip(surfaces, walls)]
    kept = [part for n, c in enumerate(clouds) for part in PARTS if getattr(c, part) is before.get((n, part), ...)]
    before.clear()
    before.update({(n, part): getattr(c, part) for n, c in enumerate(clouds) for part in PARTS})
    told.update(same=all(same), kept=kept)

def step(name, act):
    told.clear()
    handlers = bpy.app.handlers
    for hook in (handlers.frame_change_post, handlers.depsgraph_update_post):
        hook.append(read)
    act()
    bpy.context.view_layer.update()
    for hook in (handlers.frame_change_post, handlers.depsgraph_update_post):
        hook.remove(read)
    noted[name] = dict(told)

def write(item, name, key, width):
    attribute = item.data.attributes[name].data
    flat = np.zeros(len(attribute) * width, np.float32)
    attribute.foreach_get(key, flat)
    attribute.foreach_set(key, flat * 0.5)
    item.data.update_tag()

def shrink():
    tree = bpy.data.node_groups.new("shrink", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    source, sink = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    half = tree.nodes.new("GeometryNodeTransform")
    half.inputs["Scale"].default_value = (0.5, 0.5, 0.5)
    tree.links.new(source.outputs[0], half.inputs[0])
    tree.links.new(half.outputs[0], sink.inputs[0])
    moving.modifiers.new("shrink", "NODES").node_group = tree

step("first", lambda: scene.frame_set(1))
step("frame", lambda: scene.frame_set(2))
step("frame again", lambda: scene.frame_set(3))
step("cube", lambda: setattr(cube, "location", (1, 2, 3)))
step("moved", lambda: setattr(still, "location", (1, 2, 3)))
step("edited", lambda: write(still, "scale", "vector", 3))
step("edited twice", lambda: write(moving, "scale", "vector", 3))
step("modifier", shrink)
step("with it", lambda: scene.frame_set(4))
step("without", lambda: moving.modifiers.remove(moving.modifiers["shrink"]))
step("unposed", lambda: setattr(moving.modifiers[0], "show_viewport", False))
step("hidden", lambda: setattr(still, "hide_viewport", True))
step("shown", lambda: setattr(still, "hide_viewport", False))
"""


@pytest.mark.parametrize("tinted", [False, True])
def test_a_second_reading_finds_what_a_fresh_one_does_and_keeps_what_is_the_same(tmp_path, tinted):
    scene = tiny_scene()
    tints = np.arange(2, dtype=np.int8)[:, None] + np.full((len(scene.ids), 1, 3), 7, np.int8)
    write_scene(with_tints(scene, [0.0, 6.0], tints) if tinted else scene, tmp_path / "scene.f4x")
    noted, _ = perform(tmp_path, SCRIPT)
    assert [name for name, result in noted.items() if not result.get("same")] == []
    posed = {"means", "quats", "turn"}
    for name in ("frame", "frame again"):
        assert noted[name]["kept"].count("means") == 1 and noted[name]["kept"].count("sh") == 2 * (not tinted)
        assert {part for part in noted[name]["kept"] if noted[name]["kept"].count(part) == 2} >= {"scales", "opacities"}
        assert posed <= set(noted[name]["kept"])  # those of what stands still
    assert all(noted[name]["kept"].count("means") == 2 for name in ("cube", "moved"))
    assert noted["edited"]["kept"].count("scales") == 1
