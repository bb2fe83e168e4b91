"""Parts of every rendered scene in Blender: shader nodes with short words, light, keys."""

import bpy
import numpy as np

from ..f4x_core.scene.color import linear_from_srgb

FPS = 24
"""Of every rendered clip."""


class Nodes:
    """A node tree with short words for adding and linking."""

    def __init__(self, tree: bpy.types.NodeTree):
        self.tree = tree

    def add(self, kind: str, inputs: dict | None = None, **properties):
        """Add a node; an input given a socket is linked, given a value is set."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in properties.items():
            setattr(node, name, value)
        for name, value in (inputs or {}).items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[name])
            else:
                node.inputs[name].default_value = value
        return node

    def ramp(self, factor, colors, constant=False):
        """Spread colours evenly over [0, 1]."""
        node = self.add("ValToRGB", {"Fac": factor})
        ramp = node.color_ramp
        ramp.interpolation = "CONSTANT" if constant else "EASE"
        for i, color in enumerate(colors):
            position = i / (len(colors) if constant else len(colors) - 1)
            element = ramp.elements[i] if i < 2 else ramp.elements.new(position)
            element.position, element.color = position, linear_color(color)
        return node.outputs["Color"]

    def noise(self, coordinates, scale, detail=3.0):
        """Fractal noise, 0..1."""
        return self.add("TexNoise", {"Vector": coordinates, "Scale": scale, "Detail": detail}).outputs["Fac"]

    def multiply(self, a, b, amount=1.0):
        """Multiply two colours."""
        node = self.add("Mix", data_type="RGBA", blend_type="MULTIPLY")
        node.inputs[0].default_value = amount
        self.tree.links.new(a, node.inputs[6])
        self.tree.links.new(b, node.inputs[7])
        return node.outputs[2]


def linear_color(hex_color: str) -> tuple[float, float, float, float]:
    """sRGB `rrggbb` as the linear RGBA that Blender's sockets want."""
    srgb = np.array([int(hex_color[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    return (*linear_from_srgb(srgb).tolist(), 1.0)


def shade(nodes: Nodes, color) -> None:
    """Give `color` its light: diffuse under the sun plus an emission that grows towards the sky."""
    tree = nodes.tree
    up = nodes.add(
        "VectorMath", {0: nodes.add("NewGeometry").outputs["Normal"], 1: (0.25, -0.45, 0.7)}, operation="DOT_PRODUCT"
    )
    sky = nodes.add("Math", {0: up.outputs["Value"], 1: 0.2, 2: 0.42}, operation="MULTIPLY_ADD")
    emission = nodes.add("Emission", {"Color": color, "Strength": sky.outputs[0]})
    diffuse = nodes.add("BsdfDiffuse", {"Color": color})
    both = nodes.add("AddShader", {0: emission.outputs[0], 1: diffuse.outputs[0]})
    output = next((n for n in tree.nodes if n.type == "OUTPUT_MATERIAL"), None) or nodes.add("OutputMaterial")
    tree.links.new(both.outputs[0], output.inputs["Surface"])


def keyed_times(frames: int) -> range:
    """One key before and one after the clip: the Vector pass looks at both neighbours of a frame."""
    return range(-1, frames + 1)


def key_linear(datablock: bpy.types.ID, data_path: str, values: dict[int, object]) -> None:
    """Key one property at the given frames; sub-frames are never rendered, so interpolation does not matter."""
    owner = datablock
    *prefix, name = data_path.rsplit(".", 1)
    if prefix:
        owner = datablock.path_resolve(prefix[0])
    for time, value in values.items():
        setattr(owner, name, value)
        datablock.keyframe_insert(data_path, frame=time)
