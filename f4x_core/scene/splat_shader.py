"""The compositing rule as GLSL for Blender's `gpu` module: EWA projection, harmonics and alpha as in `raster.plain`.

Written for back-to-front blending with premultiplied alpha, one instance of a four-cornered strip for each Gaussian. It reads
the textures of `splat_textures`. The rule's stop at a transmittance of 1e-4 is left out: blending cannot stop, and less than
a thirtieth of an 8-bit step lies behind it. Image rows run downwards as in the rule; only `gl_Position` is turned.

Interfaces (names and GLSL types) stand beside the sources because Blender declares them itself.
"""

from __future__ import annotations

from ..geometry import spherical_harmonics as sh
from ..geometry.camera import Camera
from ..raster.contract import FRUSTUM_MARGIN, RasterConfig
from .ground import AMBIENT
from .splat_textures import CHANNELS, VIEW_TEXELS, WIDTH, SplatTextures

SPLAT_SAMPLERS = ("order", "view", *CHANNELS, "limit")
"""2D float textures, in the order of their slots."""
SPLAT_CONSTANTS = {"lens": "VEC4", "frame": "VEC4", "rule": "VEC4"}
"""fx, fy, cx, cy in pixels; width, height, near, blur; alpha_min, alpha_max, harmonics above degree 0, `split`."""
SPLAT_FLAT = {"conic": "VEC4", "shade": "VEC4"}
"""A, k, r of the exponent A (dx - k dy)^2 + r dy^2, opacity; colour, depth. The same in all of a quad."""
SPLAT_SMOOTH = {"offset": "VEC2"}
"""Pixels from the centre, x right, y down."""

_HARMONICS = f"""
vec3 coefficient(int first, int k) {{ return texel(harmonics, first + k - 1).rgb; }}

vec3 shaded(int i, vec3 base, int terms, vec3 direction)
{{
  vec3 rgb = {sh.C0} * base + 0.5;
  if (terms < 3) return rgb;
  float size = length(direction);
  vec3 d = size > 0.0 ? direction / size : direction;
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  int first = i * terms;
  rgb += {sh.C1} * (z * coefficient(first, 2) - y * coefficient(first, 1) - x * coefficient(first, 3));
  if (terms < 8) return rgb;
  rgb += {sh.C2[0]} * (x * y * coefficient(first, 4) - y * z * coefficient(first, 5) - x * z * coefficient(first, 7));
  rgb += {sh.C2[1]} * (2.0 * zz - xx - yy) * coefficient(first, 6) + {sh.C2[2]} * (xx - yy) * coefficient(first, 8);
  if (terms < 15) return rgb;
  rgb += -{sh.C3[0]} * y * (3.0 * xx - yy) * coefficient(first, 9);
  rgb += {sh.C3[1]} * x * y * z * coefficient(first, 10);
  rgb += -{sh.C3[2]} * (4.0 * zz - xx - yy) * (y * coefficient(first, 11) + x * coefficient(first, 13));
  rgb += {sh.C3[3]} * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * coefficient(first, 12);
  rgb += {sh.C3[4]} * z * (xx - yy) * coefficient(first, 14);
  rgb += -{sh.C3[0]} * x * (xx - 3.0 * yy) * coefficient(first, 15);
  if (terms < 24) return rgb;
  rgb += {sh.C4[0]} * x * y * (xx - yy) * coefficient(first, 16);
  rgb += -{sh.C4[1]} * y * z * (3.0 * xx - yy) * coefficient(first, 17);
  rgb += {sh.C4[2]} * x * y * (7.0 * zz - 1.0) * coefficient(first, 18);
  rgb += -{sh.C4[3]} * z * (7.0 * zz - 3.0) * (y * coefficient(first, 19) + x * coefficient(first, 21));
  rgb += {sh.C4[4]} * (zz * (35.0 * zz - 30.0) + 3.0) * coefficient(first, 20);
  rgb += {sh.C4[5]} * (xx - yy) * (7.0 * zz - 1.0) * coefficient(first, 22);
  rgb += -{sh.C4[1]} * x * z * (xx - 3.0 * yy) * coefficient(first, 23);
  rgb += {sh.C4[6]} * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)) * coefficient(first, 24);
  return rgb;
}}
"""

SPLAT_VERTEX = f"""
vec4 texel(sampler2D list, int i) {{ return texelFetch(list, ivec2(i % {WIDTH}, i / {WIDTH}), 0); }}

vec3 point(sampler2D list, int i)
{{
  return vec3(texel(list, 3 * i).r, texel(list, 3 * i + 1).r, texel(list, 3 * i + 2).r);
}}

vec3 turned_back(vec4 q, vec3 v)
{{
  float size = dot(q, q);
  if (size == 0.0) return v;
  vec3 axis = -q.yzw;
  vec3 t = 2.0 * cross(axis, v) / size;
  return v + q.x * t + cross(axis, t);
}}

mat3 rotation(vec4 q)
{{
  float s = 2.0 / max(dot(q, q), 1e-24);
  vec3 v = q.yzw;
  vec3 sv = s * v, w = q.x * sv, own = v * sv;
  float xy = v.x * sv.y, xz = v.x * sv.z, yz = v.y * sv.z;
  return mat3(1.0 - own.y - own.z, xy + w.z, xz - w.y,
              xy - w.z, 1.0 - own.x - own.z, yz + w.x,
              xz + w.y, yz - w.x, 1.0 - own.x - own.y);
}}
{_HARMONICS}
void main()
{{
  int i = int(texel(order, gl_InstanceID).r + 0.5);
  vec4 shape = texel(shapes, i), look = texel(looks, i);
  int own = i - int(rule.w + 0.5);
  vec4 quat, turn = vec4(1.0, 0.0, 0.0, 0.0);
  vec3 mean;
  if (own < 0) {{
    mean = point(means, i);
    quat = texel(quats, i);
  }}
  else {{
    mean = point(moving_means, own);
    quat = texel(moving_quats, own);
    turn = texel(turns, own);
  }}
  int cloud = {VIEW_TEXELS} * int(shape.w + 0.5);
  vec4 right = texelFetch(view, ivec2(cloud, 0), 0);
  vec4 down = texelFetch(view, ivec2(cloud + 1, 0), 0);
  vec4 forward = texelFetch(view, ivec2(cloud + 2, 0), 0);
  vec3 centre = texelFetch(view, ivec2(cloud + 3, 0), 0).xyz;
  vec3 at = vec3(dot(right.xyz, mean) + right.w, dot(down.xyz, mean) + down.w, dot(forward.xyz, mean) + forward.w);
  vec2 size = frame.xy, focal = lens.xy, middle = lens.zw;
  vec2 slope = at.xy / at.z, pixel = slope * focal + middle;

  vec2 margin = {0.5 * FRUSTUM_MARGIN} * size / focal;
  slope = clamp(slope, -middle / focal - margin, (size - middle) / focal + margin);
  mat3 axes = rotation(quat);
  vec3 across = (right.xyz - forward.xyz * slope.x) * (focal.x / at.z) * axes * shape.xyz;
  vec3 along = (down.xyz - forward.xyz * slope.y) * (focal.y / at.z) * axes * shape.xyz;
  vec3 minors = cross(across, along);
  float xx = dot(across, across), yy = dot(along, along), xy = dot(across, along), blur = frame.w;
  float det = dot(minors, minors) + blur * (xx + yy) + blur * blur;
  xx += blur;
  yy += blur;

  conic = vec4(yy / det, xy / yy, 1.0 / yy, look.a);
  vec3 direction = turned_back(turn, mean - centre);
  shade = vec4(max(shaded(i, look.rgb, int(rule.z + 0.5), direction), vec3(0.0)), at.z);

  // the ellipse at which alpha is alpha_min, in a rectangle along its axes
  float reach = 2.0 * max(log(look.a / rule.x), 0.0) * 1.0001 + 1e-4;
  float apart = 0.5 * (xx - yy), large = 0.5 * (xx + yy) + sqrt(apart * apart + xy * xy);
  vec2 axis = apart < 0.0 ? vec2(xy, large - xx) : vec2(large - yy, xy);
  float long_side = length(axis);
  axis = long_side > 0.0 ? axis / long_side : vec2(1.0, 0.0);
  vec2 side = vec2(-axis.y, axis.x);
  offset = corner.x * sqrt(reach * large) * axis + corner.y * sqrt(reach * det / large) * side;
  vec2 place = (pixel + offset) / size;
  gl_Position = vec4(2.0 * place.x - 1.0, 1.0 - 2.0 * place.y, 0.0, 1.0);
}}
"""

SPLAT_FRAGMENT = """
void main()
{
  float slide = offset.x - conic.y * offset.y;
  float alpha = conic.w * exp(-0.5 * (conic.x * slide * slide + conic.z * offset.y * offset.y));
  if (alpha < rule.x || shade.w >= texelFetch(limit, ivec2(gl_FragCoord.xy), 0).r) discard;
  alpha = min(alpha, rule.y);
  color = vec4(shade.rgb * alpha, alpha);
}
"""


def splat_constants(
    camera: Camera, near: float, config: RasterConfig, splats: SplatTextures
) -> dict[str, tuple[float, ...]]:
    """Return the values of `SPLAT_CONSTANTS`."""
    fx, fy, cx, cy = camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    return {
        "lens": (fx, fy, cx, cy),
        "frame": (camera.width, camera.height, near, config.blur),
        "rule": (config.alpha_min, config.alpha_max, splats.terms, splats.split),
    }


SURFACE_CONSTANTS = {"to_clip": "MAT4", "eye": "VEC4"}
"""World to clip space; the camera's centre and the depth from which on nothing is drawn."""
SURFACE_SMOOTH = {"ray": "VEC3", "depth": "FLOAT", "normal_at": "VEC3", "color_at": "VEC4"}
SURFACE_VERTEX = """
void main()
{
  gl_Position = to_clip * vec4(pos, 1.0);
  depth = gl_Position.w;
  ray = pos - eye.xyz;
  normal_at = normal;
  color_at = color;
}
"""
SURFACE_FRAGMENT = f"""
void main()
{{
  if (depth > eye.w) discard;
  float cosine = abs(dot(normal_at, ray)) / (length(normal_at) * length(ray));
  ground = vec4(color_at.rgb * ({AMBIENT} + {1 - AMBIENT} * cosine), 1.0);
  nearest = depth;
}}
"""

LINEAR_VERTEX = """
void main() { gl_Position = vec4(corner, 0.0, 1.0); }
"""
LINEAR_FRAGMENT = """
void main()
{
  vec3 rgb = max(texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb, vec3(0.0));
  vec3 high = pow((rgb + 0.055) / 1.055, vec3(2.4));
  color = vec4(mix(high, rgb / 12.92, lessThanEqual(rgb, vec3(0.04045))), 1.0);
}
"""
"""sRGB to linear light, as `color.linear_from_srgb`."""
