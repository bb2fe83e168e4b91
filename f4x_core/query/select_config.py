"""The tuned numbers of selections by marks. Needs numpy alone.

All of them were chosen on the choosing half of the clips (`benchmarks/halves.py`) or, where a field says so, on others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class GraphConfig:
    """Superpoints of Gaussians and the bonds between them."""

    moving: int = 1000
    """Superpoints of moving Gaussians. With so many, labelling superpoints rather than Gaussians costs .02 of IoU, and matrices of
    all pairs stay small."""
    static: int = 2000
    """Superpoints of static Gaussians."""
    rounds: int = 5
    """Rounds of k-means: superpoints need not converge, they only have to be compact."""
    sample: int = 1 << 14
    """Gaussians that k-means runs on."""
    times: int = 24
    """Times, evenly over the clip, at which places are compared, as many lives are short."""
    grouped_by: int = 3
    """So many of these times group Gaussians."""
    views: int = 24
    """Views, evenly over the clip, in which blend weights are summed."""
    glances: int = 8
    """Views, evenly over the clip, that show what lies between parts of a thing."""
    columns: int = 120
    """Width of these views in pixels."""
    present: float = 0.5
    """A superpoint is present while so much of it is as this fraction of its most."""
    absent: float = 1e-3
    """Weight of an absent Gaussian in the place of its superpoint, so that one of which none is present has a place."""
    directions: int = 16
    """Principal directions of the features that tell looks apart; the others are noise and cost time."""
    colour: float = 0.7
    """Weight of colour (sRGB, 1 = black to white) beside unit features in the distance of two looks."""
    features: float = 0.5
    """Weight of features beside place (in its standard deviations) when superpoints are made; colour counts 1."""
    static_features: float = 0.12
    """Further weight of the features of static Gaussians: they say what a thing is, but blur where it ends."""
    sight: float = 8.0
    """Weight of the direction in which static Gaussians are seen (1 = a radian) beside colour: with monocular depth, angles from
    the middle camera compare better than metres."""
    far: float = 1.5
    """Weight of the logarithm of the distance of static Gaussians beside colour."""
    neighbours: int = 12
    """Minimum number of superpoints that one is bonded to."""
    rigid: float = 0.1
    """Change of two neighbours' distance, as a fraction of it, up to which they move as one."""
    noise: float = 3.0
    """Or up to so many medians of the change over all neighbours, as fits are not exact."""
    lasting: float = 1.5
    """Times these two for neighbours of one piece. Four filmed clips then stay in one piece, two things that touch do not."""
    together: float = 0.3
    """Of what differing looks take from the bond of two neighbours, the fraction that it keeps where their distance stays the same:
    a car's bonnet moves with its doors. Chosen on six filmed clips, on which .6 does as well."""
    blending: float = 2.0
    """Bonds of full strength from a superpoint that looks like the background behind it to that background."""
    differs: float = 0.035
    """Difference from the background behind (`standing_out.unlike`) for which such a bond is weaker by 1/e."""
    cast: float = 0.085
    """Moving Gaussians that differ less than this from the background behind are cast on it: shadows, ripples, reflections."""
    unsure: float = 0.02
    """Within about so much of `cast` the neighbours decide."""
    vote: float = 0.1
    """Weight of their bonds of full strength beside a superpoint of mean weight."""


@dataclass(frozen=True)
class MoverConfig:
    """Movers that are apart most of the time (`movers`).

    Chosen on fits of rendered people and things that cross (people-cross, crossing), where 1.5 and 2.5 in place of `gap` find both
    movers, and on dog, camel, car-shadow and blackswan, which stay in one piece with either.
    """

    gap: float = 2.0
    """Superpoints are linked across so many usual distances to the nearest one."""
    usual: float = 0.9
    """Quantile of these distances that is usual: what sticks out of a thing, as a leg does, lies apart a little."""
    least: float = 0.05
    """Fraction of the blend weights that a mover has at least, and a cluster that counts."""
    apart: float = 0.5
    """Fraction of the times both are there at which two movers are apart, at least."""
    meet: float = 0.5
    """Times at which superpoints of two movers are both there, at least, as a fraction of those at which two of one are: above 1
    for true movers, .1 for what is lost behind another mover and found again."""
    sure: float = 0.25
    """Difference of that fraction by which it is known which of two movers a superpoint belongs to."""


@dataclass(frozen=True)
class Cutting:
    """Choice of the thing's outline among those along a walk."""

    contrast: float
    """Power of the mean strength of the cut bonds, as a fraction of what they could be; the rest is the power of the conductance,
    the fraction of all bonds that is cut, which favours large things."""
    clear: float
    """The first outline as weak as this is meant, or what follows as long as it gets weaker: the weakest of all is that around all
    that moves, where several things do."""


@dataclass(frozen=True)
class KindConfig:
    """Search for a thing of one kind, moving or static, on its graph."""

    escape: float
    """Fraction of the walkers that is lost at every superpoint."""
    sizes: tuple[float, float]
    """Least and greatest fraction of the blend weights that a thing has: the outline of a few superpoints can be weak by chance."""
    filled: float
    """Least fraction of the blend weights of this kind in a box that belongs to the thing: the box is drawn around it, and not much
    else of the kind is there."""
    cutting: Cutting
    """Choice of the outline. On four filmed clips `contrast` 0 and 1 find what moves (IoU .74 and .73); of what is static
    conductance takes half the picture. `clear` was chosen on a fit of breakdance, whose spectators move (IoU of the dancer's
    superpoints .56 with 0, .77 with .006 to .01; another fit parts the dancer by .01 to .02 and gains nothing); half of a thing is
    cut off by .035 and more (dog, camel, car-shadow)."""


MOVING = KindConfig(escape=1e-3, sizes=(0.02, 1.0), filled=0.9, cutting=Cutting(0.0, 0.008))
STATIC = KindConfig(escape=1e-2, sizes=(0.001, 0.3), filled=0.7, cutting=Cutting(0.9, 0.0))
"""Static things have no background to lose walkers to, and are a small part of the scene."""


@dataclass(frozen=True)
class ThingConfig:
    """Thresholds by which superpoints and Gaussians belong to a marked thing."""

    moving: KindConfig = MOVING
    """Things that move."""
    static: KindConfig = STATIC
    """Things that do not."""
    moving_point: float = 0.2
    """Least fraction of the blend weights at the points that belongs to moving Gaussians if a moving thing is meant. On four filmed
    clips, pixels inside true masks are missed as often as those outside are taken (under 1 %, ripples apart)."""
    moving_box: float = 0.25
    """The same of a box."""
    marked: float = 0.3
    """A superpoint is marked by the negative points when it has this fraction of the blend weights of the most marked one."""
    hidden: float = 0.5
    """Of its mean blend weight in a view: where a frame shows less of a superpoint, it may well lie outside of a box there. What
    comes to light later lies anywhere before: with 0 a mask finds .83 of four filmed things (IoU), with .4 or .7 .89."""
    shows: float = 0.05
    """Least blend weight, in pixels, of a Gaussian of which a picture tells whether it belongs to a static thing."""
    edge: float = 0.06
    """Greatest fraction of a thing's blend weights that a loose edge of it has; what is larger is a thing of its own. On four
    filmed clips loose edges of selections have at most .054."""
    caster: float = 0.25
    """Least fraction of its blend weights of which a piece that touches a thing is taken to have a shadow of its own: smaller ones
    are mostly parts of the shadow that differ from the background more than the rest."""
    stands_out: float = 0.1
    """A Gaussian in a shadow or a loose edge beside a thing belongs to the thing where it differs so much from what is behind it.
    On four filmed clips marks then find .004 more (IoU; .002 with .12 and .085)."""
    alike_behind: float = 0.05
    """A Gaussian of a shadow that differs less from what is behind it belongs to no thing; others there may be a thing's own, as
    wheels are. A word then selects car-shadow's car with IoU .924 in place of .863 (.919 with .04, .923 with .06), and of four
    clips a first-frame mask .005 more."""
    seen: float = 1.0
    """A moving Gaussian of so much blend weight, in pixels, on frames with masks is decided by the masks alone if it lies clearly
    in or out of them. On four filmed clips a first-frame mask then finds .007 more (IoU); with 2 or .5 pixels as much."""
    inside: float = 0.7
    """Fraction in the masks from which it is in the thing; with .6 the same within .001."""
    outside: float = 0.3
    """Fraction in the masks up to which it is not; with .2 or .4 the same within .001."""


@dataclass(frozen=True)
class PictureConfig:
    """Superpixels of a picture, and the choice among them for a click on something static."""

    columns: int = 480
    """Width in pixels of the pictures that are cut, whatever the clip's: windows and sizes are those of such pictures."""
    fine: tuple[int, ...] = (1, 2)
    """Sides, in pixels, of the windows whose colours are compared to find borders."""
    coarse: tuple[int, ...] = (2, 4, 8)
    """Sides of those that weigh them."""
    noise: float = 0.06
    """Difference of colour (1 = black to white) that counts as a border where both sides are smooth."""
    bins: int = 12
    """Of the histogram of each opponent colour in a superpixel."""
    faint: float = 0.2
    """Strength of the border, in [0, 1], for which a bond is weaker by 1/e."""
    alike: float = 0.15
    """The same of a histogram's part that two do not share."""
    looks: float = 0.1
    """The same of the cosine of their `visual` features, where the scene has them."""
    leak: float = 3e-3
    """Fraction of the walkers that is lost at every superpixel."""
    usual: float = math.exp(-5.0)
    """The usual size of a thing, as a fraction of the picture."""
    size: float = 0.1
    """Weight of the squared logarithm of another size against the logarithm of the mean bond that is cut. One point tells no
    size: without this a click finds .45 of what is meant, with it .52 (mean IoU of 38 things on six filmed clips). Twice the
    weight, or 1.6 times or a part of the size, change that by .03 or less."""
    spread: float = 0.025
    """Marks that are wider or higher than so many widths of the picture tell a size."""
    spread_size: float = 0.3
    """The weight that this size has in place of `size`."""
    sizes: tuple[float, float] = (3e-4, 0.6)
    """Least and greatest fraction of the picture that is meant."""
    greatest: float = 0.95
    """The greatest where marks tell a size."""
    marked: float = 0.3
    """A superpixel is marked as not meant by this fraction of the pixels in the most marked one."""
    held: float = 0.5
    """Least fraction of each mark on the thing that it holds."""
    hidden: float = 0.5
    """A superpixel with more than this fraction of moving Gaussians shows nothing static."""


@dataclass(frozen=True)
class FollowConfig:
    """Following of a mask on one frame through all frames."""

    lifted: int = 20
    """Frames, evenly over the clip, whose masks are lifted to Gaussians; 0 = the prompted ones alone, which is quick."""
    prompted_weight: float = 3.0
    """A prompted frame counts as so many others: its mask is the user's."""
    min_blend_weight: float = 0.05
    """Blend weight in pixels, summed over all lifted frames, below which a Gaussian's score comes from its neighbours."""
    neighbours: int = 8
    """Number of those neighbours."""
    one_kind: float = 0.9
    """A prompt means moving Gaussians alone if they hold at least this fraction of its blend weights, and static ones alone if
    those do."""
    colour_weight: float = 4.0
    """World units (1 = median depth) that a colour difference of 1 is worth when neighbours are looked for."""


@dataclass(frozen=True)
class MatteConfig:
    """Refinement of the outline of a selection in the picture.

    Chosen on quick fits of camel, car-shadow and dog: mean J of a first-frame mask .898 to .913, of a click .813 to .836. The
    clip's frames in place of the drawn pictures give the mask .917. Refined twice, camel gains another .003 and car-shadow loses
    .014. GrabCut (mixtures of five colours, a cut) in the same band: camel .844 and car-shadow .891.
    """

    reach: float = 4 / 480
    """Half the width of the band that is refined, in widths of the picture."""
    window: float = 50 / 480
    """Reach of pixels in the colour models, in widths of the picture; with 30 J is .005 less on camel, with 80 the same."""
    colours: int = 24
    """Main colours of the picture by which both models are histograms; with 40 the same within .001."""
    sample: int = 4096
    """Pixels that they are found by."""
    alike: float = 0.06
    """Standard deviation, in opponent colours (1 = black to white), of pixels that are of one main colour."""
    unknown: float = 0.05
    """Added to both models' probabilities: a colour that neither has seen says nothing."""
    enough: float = 0.002
    """Least fraction of the window that both sides have, else colours say nothing."""
    differs: float = 0.04
    """Difference from the background behind (`standing_out.unlike`) of a pixel that is as likely the thing's as not."""
    unsure: float = 0.025
    """Of that difference, what changes the log-odds by 1."""
    against: float = 3.0
    """Greatest log-odds against the thing by the background."""
    favour: float = 1.0
    """Greatest log-odds for it: a pixel that the thing half covers differs, too."""
    alike_behind: float = 0.05
    """Difference from the background up to which a pixel within the outline may be that background: the ground between legs, a
    shadow, ripples. With .1 and `doubt` 1 mattes of the choosing half are .002 worse (J), and without both."""
    doubt: float = 2.0
    """Greatest log-odds by its coverage for such a pixel."""
    bond: float = 3.0
    """Bonds of full strength between neighbours, against a pixel's own probability."""


@dataclass(frozen=True)
class OutlineConfig:
    """Lifting of refined outlines back to Gaussians (`outlines`).

    Chosen on quick fits of camel, car-shadow, dog and blackswan, a click and a mask each: mean J of whole Gaussians .869 to .882,
    of their mattes .879 to .889.
    """

    views: int = 5
    """Views, evenly over the clip, without its ends; eight find the same within .001."""
    columns: int = 240
    """Their width in pixels; with 320 and 480 J is the same within .003."""
    rounds: int = 2
    """The outlines of what is left are looked at again. With one round a click on camel has .008 more J and one on blackswan .025
    less, and more of what is beside a thing stays."""
    matte: MatteConfig = field(default_factory=lambda: MatteConfig(alike_behind=0.1, doubt=1.0))
    """Their refinement: over several views what looks like the background may be doubted more than in one. With (.07, 0), (.07, 1)
    and (.05, 2) the mattes have .888, .888 and .887."""
    lifted: int = 480
    """Width at which they are lifted: in small pictures Gaussians are drawn wider than they are, and rims seem to lie outside (of
    car-shadow a click then finds .911 in place of .929)."""
    seen: float = 0.3
    """Least blend weight, in pixels of all these views at that width, of a Gaussian that they decide."""


@dataclass(frozen=True)
class SelectConfig:
    """All numbers that tune a selection by marks."""

    graph: GraphConfig = field(default_factory=GraphConfig)
    """Superpoints and their bonds."""
    movers: MoverConfig = field(default_factory=MoverConfig)
    """Movers that are apart most of the time."""
    thing: ThingConfig = field(default_factory=ThingConfig)
    """Membership of a marked thing."""
    picture: PictureConfig = field(default_factory=PictureConfig)
    """Superpixels, for static things."""
    follow: FollowConfig = field(default_factory=FollowConfig)
    """Following of masks through the clip."""
    matte: MatteConfig = field(default_factory=MatteConfig)
    """Refinement of outlines in pictures."""
    outline: OutlineConfig = field(default_factory=OutlineConfig)
    """Lifting of these outlines to Gaussians."""


SELECT = SelectConfig()
"""The numbers that every selection takes unless it is given others."""
