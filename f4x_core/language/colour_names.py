"""Colours by name: those of CSS, some more that people say, and shades of them."""

from __future__ import annotations

import colorsys

CSS = (
    "aliceblue f0f8ff antiquewhite faebd7 aqua 00ffff aquamarine 7fffd4 azure f0ffff beige f5f5dc bisque ffe4c4 black 000000 "
    "blanchedalmond ffebcd blue 0000ff blueviolet 8a2be2 brown a52a2a burlywood deb887 cadetblue 5f9ea0 chartreuse 7fff00 "
    "chocolate d2691e coral ff7f50 cornflowerblue 6495ed cornsilk fff8dc crimson dc143c cyan 00ffff darkblue 00008b darkcyan "
    "008b8b darkgoldenrod b8860b darkgray a9a9a9 darkgreen 006400 darkkhaki bdb76b darkmagenta 8b008b darkolivegreen 556b2f "
    "darkorange ff8c00 darkorchid 9932cc darkred 8b0000 darksalmon e9967a darkseagreen 8fbc8f darkslateblue 483d8b darkslategray "
    "2f4f4f darkturquoise 00ced1 darkviolet 9400d3 deeppink ff1493 deepskyblue 00bfff dimgray 696969 dodgerblue 1e90ff firebrick "
    "b22222 floralwhite fffaf0 forestgreen 228b22 fuchsia ff00ff gainsboro dcdcdc ghostwhite f8f8ff gold ffd700 goldenrod daa520 "
    "gray 808080 green 008000 greenyellow adff2f honeydew f0fff0 hotpink ff69b4 indianred cd5c5c indigo 4b0082 ivory fffff0 khaki "
    "f0e68c lavender e6e6fa lavenderblush fff0f5 lawngreen 7cfc00 lemonchiffon fffacd lightblue add8e6 lightcoral f08080 lightcyan "
    "e0ffff lightgoldenrodyellow fafad2 lightgray d3d3d3 lightgreen 90ee90 lightpink ffb6c1 lightsalmon ffa07a lightseagreen "
    "20b2aa lightskyblue 87cefa lightslategray 778899 lightsteelblue b0c4de lightyellow ffffe0 lime 00ff00 limegreen 32cd32 linen "
    "faf0e6 magenta ff00ff maroon 800000 mediumaquamarine 66cdaa mediumblue 0000cd mediumorchid ba55d3 mediumpurple 9370db "
    "mediumseagreen 3cb371 mediumslateblue 7b68ee mediumspringgreen 00fa9a mediumturquoise 48d1cc mediumvioletred c71585 "
    "midnightblue 191970 mintcream f5fffa mistyrose ffe4e1 moccasin ffe4b5 navajowhite ffdead navy 000080 oldlace fdf5e6 olive "
    "808000 olivedrab 6b8e23 orange ffa500 orangered ff4500 orchid da70d6 palegoldenrod eee8aa palegreen 98fb98 paleturquoise "
    "afeeee palevioletred db7093 papayawhip ffefd5 peachpuff ffdab9 peru cd853f pink ffc0cb plum dda0dd powderblue b0e0e6 purple "
    "800080 rebeccapurple 663399 red ff0000 rosybrown bc8f8f royalblue 4169e1 saddlebrown 8b4513 salmon fa8072 sandybrown f4a460 "
    "seagreen 2e8b57 seashell fff5ee sienna a0522d silver c0c0c0 skyblue 87ceeb slateblue 6a5acd slategray 708090 snow fffafa "
    "springgreen 00ff7f steelblue 4682b4 tan d2b48c teal 008080 thistle d8bfd8 tomato ff6347 turquoise 40e0d0 violet ee82ee wheat "
    "f5deb3 white ffffff whitesmoke f5f5f5 yellow ffff00 yellowgreen 9acd32"
)
"""Names and hexadecimal values of CSS Color Module Level 4, section 6.1."""
MORE = (
    "amber ffbf00 apricot fbceb1 babyblue 89cff0 babypink f4c2c2 bloodred 8a0303 bottlegreen 006a4e brickred cb4154 bronze "
    "cd7f32 burgundy 800020 burntorange cc5500 caramel c68e17 charcoal 36454f cherry de3163 cherryred de3163 copper b87333 "
    "cream fffdd0 emerald 50c878 emeraldgreen 50c878 fuschia ff00ff golden ffd700 grassgreen 7cfc00 jade 00a86b jetblack "
    "0a0a0a lemon fff44f lemonyellow fff44f lilac c8a2c8 mauve e0b0ff mint 98ff98 mintgreen 98ff98 mustard ffdb58 navyblue "
    "000080 ochre cc7722 olivegreen 808000 peach ffe5b4 rose ff007f ruby e0115f rust b7410e sapphire 0f52ba scarlet ff2400 "
    "shockingpink fc0fc0 sunflower ffda03 tangerine f28500 taupe 483c32 terracotta e2725b ultramarine 3f00ff vermilion e34234 "
    "vermillion e34234 wine 722f37 winered 722f37 amethyst 9966cc aubergine 472c4c eggplant 614051 avocado 568203 auburn "
    "a52a2a blond faf0be blonde faf0be blush de5d83 brass b5a642 canaryyellow ffef00 carmine 960018 celadon ace1af cerise "
    "de3163 cerulean 007ba7 champagne f7e7ce chestnut 954535 chestnutbrown 954535 chocolatebrown d2691e cinnamon d2691e "
    "claret 7f1734 cobalt 0047ab cobaltblue 0047ab denim 1560bd denimblue 1560bd ebony 282c35 ecru c2b280 eggshell f0ead6 "
    "electricblue 7df9ff fawn e5aa70 garnet 733635 ginger b06500 graphite 41424c gunmetal 2a3439 hazel 8e7618 iceblue d6ecef "
    "inkblue 10263b kellygreen 4cbb17 mahogany c04000 marigold eaa221 mocha 967969 mossgreen 8a9a5b mulberry c54b8c neongreen "
    "39ff14 neonpink ff6ec7 neonyellow ffff33 offwhite faf9f6 onyx 353839 oxblood 4a0000 pearlwhite f0ead6 periwinkle ccccff "
    "petrol 005f6a petrolblue 005f6a pistachio 93c572 britishracinggreen 004225 racinggreen 004225 raspberry e30b5d rosegold "
    "b76e79 russet 80461b saffron f4c430 sage b2ac88 sagegreen b2ac88 sandcolored c2b280 slate 708090 seablue 006994 "
    "strawcolored e4d96f tawny cd5700 topaz ffc87c umber 635147 vanilla f3e5ab peagreen 8fae22 armygreen 4b5320 olivebrown "
    "645403 dustypink d58a94 dustyrose dcae96 duckeggblue c3fbf4 applegreen 8db600 aquablue 00ffff bubblegumpink ffc1cc "
    "coffeebrown 6f4e37 creamwhite fffdd0 fleshcolored ffcba4 skincolored ffcba4"
)
"""Others that people say."""

Colour = tuple[float, float, float]


def _colours(names: str) -> dict[str, Colour]:
    words = names.split()
    return {name: from_hex(digits) for name, digits in zip(words[::2], words[1::2], strict=True)}


def from_hex(digits: str) -> Colour:
    """Return sRGB in [0, 1] of three or six hexadecimal digits, to three places: enough for a byte."""
    digits = digits if len(digits) == 6 else "".join(2 * digit for digit in digits)
    red, green, blue = (round(int(digits[i : i + 2], 16) / 255, 3) for i in (0, 2, 4))
    return red, green, blue


COLOURS = _colours(MORE) | _colours(CSS)
"""Name without spaces -> sRGB in [0, 1]."""
HALF = 0.5
"""Fraction of the way that a shade goes to white or black."""
LIGHT, DARK, BRIGHT = ("light", "pale", "soft", "pastel"), ("dark", "deep"), ("bright", "vivid", "neon")
SHADES = (*LIGHT, *DARK, *BRIGHT)
"""Words before a color: mixed with white, mixed with black, as bright as the hue can be."""


def shaded(shade: str, colour: Colour) -> Colour:
    """Return a color as a word of `SHADES` before it changes it, where CSS has no name for both."""
    if shade in BRIGHT:
        brightest = max(colour) or 1.0
        red, green, blue = (round(c / brightest, 3) for c in colour)
    else:
        red, green, blue = (round(c + HALF * ((shade in LIGHT) - c), 3) for c in colour)
    return red, green, blue


def name_of(colour: Colour) -> str | None:
    """Return the shortest name of exactly this color; None where it has none."""
    names = [name for name, value in COLOURS.items() if value == colour]
    return min(names, key=lambda name: (len(name), name), default=None)


_HUES = {15: "red", 45: "orange", 70: "yellow", 170: "green", 200: "turquoise", 260: "blue", 300: "purple", 345: "pink"}
"""Degrees of hue up to which a colour is called so."""
BLACK_VALUE, WHITE_VALUE, GRAY_SATURATION, BROWN_VALUE = 0.2, 0.8, 0.15, 0.6
"""HSV numbers below or above which a colour is black, white, gray, and an orange is brown."""


def everyday_name(colour: Colour) -> str:
    """Return one of the eleven basic color words for a color."""
    hue, saturation, value = colorsys.rgb_to_hsv(*(min(max(c, 0.0), 1.0) for c in colour))
    if value < BLACK_VALUE:
        return "black"
    if saturation < GRAY_SATURATION:
        return "white" if value > WHITE_VALUE else "gray"
    name = next((name for end, name in _HUES.items() if 360 * hue < end), "red")
    return "brown" if name == "orange" and value < BROWN_VALUE else name
