"""The dual-quaternion blend as one geometry-nodes tree: animated empties carry the dynamic Gaussians, live.

Every Gaussian has its own reference frame r, so what moves it is the relative motion `Q_k(now) Q_k(r)^-1` of each of
its K nodes. A hidden helper mesh has one vertex per (node, reference) pair in use, with the attributes

    node         INT           place of the empty in its collection, read in the natural order of names (`repair`)
    rest_turn    QUATERNION    rotation of Q_k(r)^-1 in the scene's own frame
    rest_place   FLOAT_VECTOR  translation of Q_k(r)

and the tree works on it first: the pair's motion as a unit dual quaternion, in three vectors (no socket holds eight
floats, and taking colours apart costs more): Real and Dual, the vector parts of its halves, and Scalars = (real scalar,
dual scalar, 0). The Gaussians carry

    pair_0 .. pair_K-1   INT     vertices of the helper, the attach node's first
    w_0 .. w_K-1         FLOAT   skinning weights, sum 1
    strength             FLOAT   0 stays put, 1 follows

and are blended as in `f4x_core.scaffold.deformation.blend`; `position` and `rotation` then hold the posed values,
and `turn` (QUATERNION) the rotation that the motion gave, by which the harmonics turn as well.

Fields that are captured together are evaluated once, those that are stored one by one each anew; hence the captures.
"""

import bpy

from ...f4x_core.geometry.spherical_harmonics import C0
from ...f4x_core.scaffold.deformation import COLLAPSED, SIGN_BAND
from ...f4x_core.scene.tints import LEVELS

MOTION = "Feature4X motion"
"""Name of the modifier that moves the dynamic Gaussians."""
PRESENCE = "Feature4X presence"
"""Name of the modifier by which Gaussians come and go; its input `Time` is the clip frame that is shown (`clip_time`)."""
TINTS = "Feature4X colors over time"
"""Name of the modifier that adds tints to colors; its input `Knot` says between which ones Time is (`tints`)."""
TINT, TINT_GAIN = ".f4x_tint_", ".f4x_tint_gain"
"""Point attributes, the first without its number, and by how much edits and heat maps change tints. The dot hides them in lists."""
BYTE = 256
"""Steps of one channel of a tint that is packed into a whole number."""
FIRST_PAIR = "pair_0"
"""Attribute that all point clouds have that nodes carry."""
STEP = 1e-4
"""Frames that the shortest ramp of a presence lasts."""
SCENE_FRAME = "RELATIVE"
"""Empties are read in the frame of the Gaussians' object: the scene's own."""


class _Tree:
    """A geometry node group with short words for adding and linking nodes."""

    def __init__(self, name: str, inputs: dict[str, str], outputs: dict[str, str]):
        """Create an empty tree with the sockets `inputs` and `outputs`, each name -> socket type."""
        self.tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
        for direction, sockets in (("INPUT", inputs), ("OUTPUT", outputs)):
            for socket, kind in sockets.items():
                self.tree.interface.new_socket(socket, in_out=direction, socket_type=kind)
        self.inputs = self.tree.nodes.new("NodeGroupInput").outputs
        self.outputs = self.tree.nodes.new("NodeGroupOutput").inputs

    def link(self, source, target) -> None:
        """Connect two sockets."""
        self.tree.links.new(source, target)

    def add(self, kind: str, *inputs, **properties):
        """Add a node; positional inputs (None = leave) go to its available sockets in order, linked or set."""
        node = self.tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(node, name, value)
        free = [socket for socket in node.inputs if socket.enabled]
        for socket, value in zip(free, inputs, strict=False):
            if isinstance(value, bpy.types.NodeSocket):
                self.link(value, socket)
            elif value is not None:
                socket.default_value = value
        return node

    def out(self, kind: str, *inputs, **properties):
        """Add a node and return its first available output."""
        return next(s for s in self.add(kind, *inputs, **properties).outputs if s.enabled)

    def math(self, operation: str, *inputs):
        """Number arithmetic."""
        return self.out("ShaderNodeMath", *inputs, operation=operation)

    def vector(self, operation: str, *inputs):
        """Add vector arithmetic and return its output; a number on an input fills all three components."""
        return self.out("ShaderNodeVectorMath", *inputs, operation=operation)

    def scaled(self, vector, factor):
        """Add the product of a vector and a number, and return its output."""
        node = self.tree.nodes.new("ShaderNodeVectorMath")
        node.operation = "SCALE"
        self.link(vector, node.inputs["Vector"])
        if isinstance(factor, bpy.types.NodeSocket):
            self.link(factor, node.inputs["Scale"])
        else:
            node.inputs["Scale"].default_value = factor
        return node.outputs[0]

    def attribute(self, name: str, data_type: str):
        """Return the field of a named attribute."""
        return self.out("GeometryNodeInputNamedAttribute", name, data_type=data_type)

    def store(self, geometry, name: str, data_type: str, value, domain: str = "POINT"):
        """Store Named Attribute."""
        return self.out(
            "GeometryNodeStoreNamedAttribute", geometry, None, name, value, data_type=data_type, domain=domain
        )

    def capture(self, geometry, **fields):
        """Evaluate fields (type of socket, field) together; returns (geometry, captured field, ...)."""
        node = self.tree.nodes.new("GeometryNodeCaptureAttribute")
        for name, (kind, _) in fields.items():
            node.capture_items.new(kind, name)
        self.link(geometry, node.inputs[0])
        for name, (_, field) in fields.items():
            self.link(field, node.inputs[name])
        return node.outputs[0], *(node.outputs[name] for name in fields)

    def sample(self, geometry, field, index, data_type: str, domain: str = "POINT"):
        """Sample Index."""
        return self.out("GeometryNodeSampleIndex", geometry, field, index, data_type=data_type, domain=domain)


def build_motion_tree(
    name: str, nodes: bpy.types.Collection, helper: bpy.types.Object, slots: int, fades: bool
) -> bpy.types.GeometryNodeTree:
    """Return the tree that poses Gaussians with `slots` = K pairs each, from the empties in `nodes`.

    `fades`: some Gaussians follow in part only, so `strength` counts.
    """
    tree = _Tree(name, {"Geometry": "NodeSocketGeometry"}, {"Posed": "NodeSocketGeometry"})
    pairs, *motion = _pair_motions(tree, nodes, helper)

    # Sum of the K weighted dual quaternions, each on the hemisphere of slot 0, the attach node.
    one_slot = _weighted_slot_group(f"{name} slot")
    attach: tuple = ()
    sums: list = []
    for k in range(slots):
        pair, weight = tree.attribute(f"pair_{k}", "INT"), tree.attribute(f"w_{k}", "FLOAT")
        parts = [tree.sample(pairs, part, pair, "FLOAT_VECTOR") for part in motion]
        if k == 0:
            attach = (parts[0], parts[2])
            sums = [tree.scaled(part, weight) for part in parts]
            continue
        slot = tree.add("GeometryNodeGroup", node_tree=one_slot)
        for socket, value in zip(slot.inputs, (*parts, weight, *attach, *sums), strict=True):
            tree.link(value, socket)
        sums = list(slot.outputs)
    real_v, dual_v, scalars = sums
    real_w, dual_w = tree.add("ShaderNodeSeparateXYZ", scalars).outputs[:2]
    if fades:
        real_v, real_w, dual_v, dual_w = _faded(
            tree, (real_v, real_w, dual_v, dual_w), tree.attribute("strength", "FLOAT")
        )

    # t = 2 (d p*)_vec / |p|^2. The part of d along p only adds to the scalar, so d needs no projection.
    squared = tree.math("MULTIPLY_ADD", real_w, real_w, tree.vector("DOT_PRODUCT", real_v, real_v))
    valid = tree.math("GREATER_THAN", squared, COLLAPSED**2)
    t = tree.vector("CROSS_PRODUCT", real_v, dual_v)
    t = tree.vector("ADD", t, tree.scaled(dual_v, real_w))
    t = tree.vector("SUBTRACT", t, tree.scaled(real_v, dual_w))
    t = tree.scaled(t, tree.math("MULTIPLY", 2.0, tree.math("DIVIDE", valid, squared)))
    parts = tree.add("ShaderNodeSeparateXYZ", tree.scaled(real_v, valid)).outputs
    scalar = tree.math("ADD", tree.math("MULTIPLY", real_w, valid), tree.math("SUBTRACT", 1.0, valid))
    turn = tree.out("FunctionNodeQuaternionToRotation", scalar, parts["X"], parts["Y"], parts["Z"])

    posed, turn, t = tree.capture(tree.inputs["Geometry"], Turn=("ROTATION", turn), Shift=("VECTOR", t))
    rotation = tree.out("FunctionNodeRotateRotation", tree.attribute("rotation", "QUATERNION"), turn)
    moved = tree.vector("ADD", tree.out("FunctionNodeRotateVector", tree.out("GeometryNodeInputPosition"), turn), t)
    posed = tree.store(posed, "rotation", "QUATERNION", rotation)
    posed = tree.store(posed, "turn", "QUATERNION", turn)
    posed = tree.out("GeometryNodeSetPosition", posed, None, moved)
    tree.link(posed, tree.outputs["Posed"])
    _lay_out(tree.tree)
    return tree.tree


def build_graph_tree(name: str, nodes: bpy.types.Collection) -> bpy.types.GeometryNodeTree:
    """Return the tree that puts each vertex of a mesh where the empty of `nodes` is whose place is its attribute `node`."""
    tree = _Tree(name, {"Geometry": "NodeSocketGeometry"}, {"Posed": "NodeSocketGeometry"})
    info = tree.add("GeometryNodeCollectionInfo", nodes, True, False, transform_space=SCENE_FRAME)
    now = tree.add("FunctionNodeSeparateTransform", tree.out("GeometryNodeInstanceTransform")).outputs["Translation"]
    place = tree.sample(info.outputs[0], now, tree.attribute("node", "INT"), "FLOAT_VECTOR", "INSTANCE")
    tree.link(tree.out("GeometryNodeSetPosition", tree.inputs["Geometry"], None, place), tree.outputs["Posed"])
    _lay_out(tree.tree)
    return tree.tree


def build_presence_tree(name: str) -> bpy.types.GeometryNodeTree:
    """Return the tree that fades Gaussians by their attributes `span_0 .. span_3`, as `f4x_core.scene.model.faded` does.

    It changes the alpha of `radiance:base` and `rgb` by the clip frame on its input `Time`.
    """
    sockets = {"Geometry": "NodeSocketGeometry", "Time": "NodeSocketFloat"}
    tree = _Tree(name, sockets, {"Faded": "NodeSocketGeometry"})
    frame = tree.inputs["Time"]
    start, there, until, end = (tree.attribute(f"span_{i}", "FLOAT") for i in range(4))

    def ramp(since, first, last):
        """Return the fraction of the way from first to last that has passed; a step where they are equal."""
        length = tree.math("MAXIMUM", tree.math("SUBTRACT", last, first), STEP)
        node = tree.add("ShaderNodeMath", since, length, operation="DIVIDE")
        node.use_clamp = True
        return node.outputs[0]

    coming = ramp(tree.math("ADD", tree.math("SUBTRACT", frame, start), STEP), start, there)
    presence = tree.math("MINIMUM", coming, ramp(tree.math("SUBTRACT", end, frame), until, end))
    geometry, presence = tree.capture(tree.inputs["Geometry"], Presence=("FLOAT", presence))
    for attribute in ("radiance:base", "rgb"):
        color = tree.add("FunctionNodeSeparateColor", tree.attribute(attribute, "FLOAT_COLOR")).outputs
        through = tree.math("POWER", tree.math("SUBTRACT", 1.0, color["Alpha"]), presence)
        seen = tree.math("SUBTRACT", 1.0, through)
        faded = tree.out("FunctionNodeCombineColor", color["Red"], color["Green"], color["Blue"], seen)
        geometry = tree.store(geometry, attribute, "FLOAT_COLOR", faded)
    tree.link(geometry, tree.outputs["Faded"])
    _lay_out(tree.tree)
    return tree.tree


def build_tints_tree(name: str) -> bpy.types.GeometryNodeTree:
    """Return the tree that adds tints to `radiance:base` and `rgb`, linear between the attributes of two knots.

    The string nodes name the two that are read; the others cost nothing. Later modifiers need none, so all are removed.
    """
    sockets = {"Geometry": "NodeSocketGeometry", "Knot": "NodeSocketFloat"}
    tree = _Tree(name, sockets, {"Tinted": "NodeSocketGeometry"})
    knot = tree.inputs["Knot"]
    lower = tree.math("FLOOR", knot)
    before, after = (_tint_at(tree, number) for number in (lower, tree.math("CEIL", knot)))
    step = tree.scaled(tree.vector("SUBTRACT", after, before), tree.math("SUBTRACT", knot, lower))
    gain = tree.scaled(tree.attribute(TINT_GAIN, "FLOAT_VECTOR"), 1 / (LEVELS * C0))
    tint = tree.add("ShaderNodeSeparateXYZ", tree.vector("MULTIPLY", tree.vector("ADD", before, step), gain)).outputs
    base = tree.add("FunctionNodeSeparateColor", tree.attribute("radiance:base", "FLOAT_COLOR")).outputs
    tinted = [tree.math("ADD", old, more) for old, more in zip(base[:3], tint[:3], strict=True)]
    color = tree.out("FunctionNodeCombineColor", *tinted, base["Alpha"])
    geometry = tree.store(tree.inputs["Geometry"], "radiance:base", "FLOAT_COLOR", color)
    base = tree.add("FunctionNodeSeparateColor", tree.attribute("radiance:base", "FLOAT_COLOR")).outputs
    color = tree.out("FunctionNodeCombineColor", *(_light(tree, dc) for dc in base[:3]), base["Alpha"])
    geometry = tree.store(geometry, "rgb", "FLOAT_COLOR", color)
    remove = tree.add("GeometryNodeRemoveAttribute", geometry)
    if hasattr(remove, "pattern_mode"):  # Blender before 5.0
        remove.pattern_mode = "WILDCARD"
    else:
        remove.inputs["Pattern Mode"].default_value = "Wildcard"
    remove.inputs["Name"].default_value = f"{TINT}*"
    tree.link(remove.outputs[0], tree.outputs["Tinted"])
    _lay_out(tree.tree)
    return tree.tree


def _tint_at(tree: _Tree, number):
    """Return the field of the tint at knot `number`: a vector in 255ths of display color."""
    text = tree.out("FunctionNodeValueToString", number, data_type="INT")
    join = tree.tree.nodes.new("GeometryNodeStringJoin")
    for part in (text, tree.out("FunctionNodeInputString", string=TINT)):  # the link that is made last comes first
        tree.link(part, join.inputs["Strings"])
    rest, channels = tree.attribute(join.outputs[0], "FLOAT"), []
    for size in (BYTE**2, BYTE):
        channels.append(tree.math("ROUND", tree.math("DIVIDE", rest, size)))
        rest = tree.math("MULTIPLY_ADD", channels[-1], -size, rest)
    return tree.out("ShaderNodeCombineXYZ", *channels, rest)


def _light(tree: _Tree, dc):
    """Return the linear light of the display color that the coefficient `dc` makes (`scene.color.linear_from_srgb`)."""
    node = tree.add("ShaderNodeMath", dc, C0, 0.5, operation="MULTIPLY_ADD")
    node.use_clamp = True
    display = node.outputs[0]
    bright = tree.math("POWER", tree.math("MULTIPLY_ADD", display, 1 / 1.055, 0.055 / 1.055), 2.4)
    dark = tree.math("SUBTRACT", tree.math("DIVIDE", display, 12.92), bright)
    return tree.math("MULTIPLY_ADD", tree.math("LESS_THAN", display, 0.04045), dark, bright)


def _pair_motions(tree: _Tree, nodes: bpy.types.Collection, helper: bpy.types.Object):
    """Return the helper's geometry with the motion of each pair captured on its vertices, a dual quaternion in three vectors."""
    info = tree.add("GeometryNodeCollectionInfo", nodes, True, False, transform_space=SCENE_FRAME)
    # An artist may resize an empty: its scale takes no part.
    now = tree.add("FunctionNodeSeparateTransform", tree.out("GeometryNodeInstanceTransform")).outputs
    node = tree.attribute("node", "INT")
    now_turn = tree.sample(info.outputs[0], now["Rotation"], node, "QUATERNION", "INSTANCE")
    now_place = tree.sample(info.outputs[0], now["Translation"], node, "FLOAT_VECTOR", "INSTANCE")
    turn = tree.out("FunctionNodeRotateRotation", tree.attribute("rest_turn", "QUATERNION"), now_turn)
    turned = tree.out("FunctionNodeRotateVector", tree.attribute("rest_place", "FLOAT_VECTOR"), turn)
    translation = tree.vector("SUBTRACT", now_place, turned)
    q = tree.add("FunctionNodeRotationToQuaternion", turn).outputs
    real_v = tree.out("ShaderNodeCombineXYZ", q["X"], q["Y"], q["Z"])
    # d = (0, t) p / 2
    dual_v = tree.vector("CROSS_PRODUCT", translation, real_v)
    dual_v = tree.scaled(tree.vector("ADD", dual_v, tree.scaled(translation, q["W"])), 0.5)
    dual_w = tree.math("MULTIPLY", -0.5, tree.vector("DOT_PRODUCT", translation, real_v))
    pairs = tree.add("GeometryNodeObjectInfo", helper, transform_space="ORIGINAL").outputs["Geometry"]
    scalars = tree.out("ShaderNodeCombineXYZ", q["W"], dual_w)
    return tree.capture(pairs, Real=("VECTOR", real_v), Dual=("VECTOR", dual_v), Scalars=("VECTOR", scalars))


def _weighted_slot_group(name: str) -> bpy.types.GeometryNodeTree:
    """Return a node group that adds one weighted, sign-aligned dual quaternion to the running sums."""
    motion = ("Real", "Dual", "Scalars")
    sums = [f"Sum of {part}" for part in motion]
    vectors = (*motion, "Weight", "Attach Real", "Attach Scalars", *sums)
    inputs = dict.fromkeys(vectors, "NodeSocketVector") | {"Weight": "NodeSocketFloat"}
    tree = _Tree(name, inputs, dict.fromkeys(sums, "NodeSocketVector"))

    scalar, attach_scalar = (
        tree.add("ShaderNodeSeparateXYZ", tree.inputs[part]).outputs[0] for part in ("Scalars", "Attach Scalars")
    )
    dot = tree.vector("DOT_PRODUCT", tree.inputs["Real"], tree.inputs["Attach Real"])
    dot = tree.math("MULTIPLY_ADD", scalar, attach_scalar, dot)
    sign = tree.math("MULTIPLY_ADD", tree.math("LESS_THAN", dot, -SIGN_BAND), -2.0, 1.0)
    weight = tree.math("MULTIPLY", sign, tree.inputs["Weight"])
    for part, total in zip(motion, sums, strict=True):
        tree.link(tree.vector("ADD", tree.scaled(tree.inputs[part], weight), tree.inputs[total]), tree.outputs[total])
    _lay_out(tree.tree)
    return tree.tree


def _faded(tree: _Tree, sums, strength):
    """Blend with the identity on its hemisphere: `o P + (1 - o) 1, o D`."""
    real_v, real_w, dual_v, dual_w = sums
    negative = tree.math("LESS_THAN", real_w, 0.0)
    signed = tree.math("MULTIPLY", strength, tree.math("MULTIPLY_ADD", negative, -2.0, 1.0))
    rest = tree.math("SUBTRACT", 1.0, strength)
    return (
        tree.scaled(real_v, signed),
        tree.math("MULTIPLY_ADD", real_w, signed, rest),
        tree.scaled(dual_v, signed),
        tree.math("MULTIPLY", dual_w, signed),
    )


def _lay_out(tree: bpy.types.NodeTree) -> None:
    """Place nodes in columns by their distance from the inputs, so that a person can read the tree."""
    sources: dict = {node: [] for node in tree.nodes}
    for link in tree.links:
        sources[link.to_node].append(link.from_node)
    depth: dict = {}

    def column(node) -> int:
        if node not in depth:
            depth[node] = 1 + max((column(source) for source in sources[node]), default=-1)
        return depth[node]

    rows: dict[int, int] = {}
    for node in tree.nodes:
        x = column(node)
        node.location = (220 * x, -180 * rows.get(x, 0))
        rows[x] = rows.get(x, 0) + 1
