"""Verbs of edits by sense: one table, of which `any_form` makes the alternatives of a rule."""

from __future__ import annotations

from collections.abc import Sequence

from .grammar import VOCABULARY
from .lexicon import every_form, forms, inflected, word_set

VERBS: dict[str, str] = {
    # appearance
    "become": "blush, flush, bleed, ripen, melt, hue shift, mark, mark up, flag, color code, accent, settle on, experiment with, "
    "inject, breathe, snap, retint, lerp, interpolate, tween, ramp, blend, highlight, try, try out, test, make, turn, render, "
    "change, convert, transform, give, paint, repaint, color, recolor, dye, spray, respray, spray paint, set, put, get, let, play, "
    "run, use, apply, do, keep, switch, bring, show, adjust, display, look, feel, become, have, go, seem, cover, coat, drench, "
    "dip, bathe, dress up, wrap, stain, shade, decorate, slap, splash, splatter, throw, smear, brush, lacquer, style, restyle, "
    "redo, colorize, tone, transition, morph, draw, pick, choose, select, add, sprinkle, lay, shift, swap, flip, restore, place, "
    "edit, modify, wear, ask for, go for, go with, opt for, fill, flood, soak, grade, reskin, retexture, recolorise, reshade, "
    "dunk, varnish, shift over, bring over, kit out, drape, steep, cloak, swathe, shroud, repurpose, slather, daub, tart up, jazz "
    "up, doll up, deck out",
    "tint": "tint, tinge, tone, wash, stain slightly, suffuse, hint",
    "set": "clamp, peg, trim, dip, whack, set, change, make, turn, put, bring, adjust, take, get, give, have, need, show, apply, "
    "use, keep, correct, modify, tweak, fix, move, pull, push, dial, drag, slide, crank, pump, knock, ramp, kick, jack, tone, "
    "want, could use, can use, could do with, deserve, go, run, let, play",
    "more": "whack, increase, raise, boost, crank, push, pump, kick, jack, ramp, turn up, bump up, crank up, pump up, dial "
    "up, bring up, push up, strengthen, enhance, intensify, bump, lift, add, pull up, amplify, up, ramp up, jack up, beef up, "
    "heighten, hike, step up, punch up, take up, deepen, improve, extend, augment, multiply, advance, go up, grow, buff, boost "
    "up, juice up, gain up, ride up, nudge up, inch up, creep up, notch up, hike up, max out, tick up, edge up, exaggerate, "
    "accentuate, emphasize, magnify, maximize, elevate",
    "less": "shave, slash, slice, skim, chop, "
    "easy on, go easy on, take it easy on, lay off, ease up on, ease off on, hold back on, cut back on, back off on, cool it "
    "with, reduce, decrease, lower, turn down, knock back, pull, back off, roll off, bring back, cut, cut down, lessen, tone "
    "down, bring down, dial down, weaken, diminish, drop, take down, cut back, pull down, take back, pull back, dial back, ramp "
    "down, scale back, soften, ease, mute, knock down, step down, go down, minimize, tame, subdue, shrink, bump down, push down, "
    "limit, curb, moderate, attenuate, crank down, drag down, nerf, gain down, ride down, ease down, nudge down, inch down, notch "
    "down, tick down, edge down, dampen, tone back, suppress, crush down, level down, de emphasize, understate",
    "brighten": "dodge, lift the exposure of, shed light on, lighten up, brighten, lighten, brighten up, lighten up, illuminate, "
    "light up, light, illumine, expose up, kick up the exposure of, push the exposure of, raise the exposure of, gain up, "
    "give light to, throw light on, perk up the light of",
    "darken": "burn in, darken, dim, darken down, dim down, shade, underexpose, expose down, drop the exposure of, lower the "
    "exposure of, blacken down, overshadow, knock down the light of",
    "enlarge": "embiggen, biggen, scale it up, buff, beef up, enlarge, grow, magnify, scale up, blow up, upscale, upsize, "
    "expand, inflate, size up, swell, swell up, puff up, bulk up, balloon, bloat, supersize, pump up, widen, zoom up, double "
    "up, broaden, get bigger, get larger, scale out, big up, jumbo, jumbo size, super size, plump up, fatten up, make grow, "
    "make huge, up the size of, up the scale of",
    "shrink": "minify, dwarf, nerf, shrink, scale down, shrink down, downscale, downsize, minimize, size down, contract, "
    "miniaturize, reduce, compress, get smaller, dwindle, squash down, deflate, cut down, scale in, shrinkify, tiny up, minimise, "
    "miniaturise, reduce in size, make shrink, squish, squish down, whittle down, knock down in size, half size, down the size of",
    "quicken": "fast forward, turbocharge, rev up, pick up the pace, pick up speed, speed up, accelerate, quicken, hasten, "
    "hurry, hurry up, rush, hustle, speed ramp up, undercrank, ramp up the speed of, step on it with, put the pedal down on, "
    "make hurry, hurry along, hyper speed, hyperlapse, time lapse, timelapse, fast track",
    "pace": "retime, remap, time remap, speed ramp, time ramp, conform",
    "slow": "slow mo, ease down, slow down, slow, decelerate, brake, calm, calm down, overcrank, slo mo, slomo, ramp down "
    "the speed of, ease off, throttle, throttle down, rein back, bullet time",
    "saturate": "boost the color of, punch up, saturate, enrich, liven up, enliven, perk up, spice up, vivify, pump up the "
    "colors of, boost the colors of, color boost, brighten the colors of, turn up the colors of, crank the colors of, juice "
    "up, vibrance up, amp up the colors of, jazz up the colors of",
    "desaturate": "desaturate, decolor, decolorize, gray out, bleach out, take the color out of, drain the color from, drain the "
    "color out of, suck the color out of, strip the color from, leach the color from, remove the color from, pull the color out "
    "of, kill the color in, kill the color of, monochrome, turn black and white, make black and white, bleach the color out of",
    "mute": "mute, dull, dull down, wash out",
    "warm": "warm, warm up",
    "cool": "cool, cool down, cool off, chill",
    "scale": "scale, resize, rescale, size",
    # visibility
    "delete": "tidy away, cull, prune, eradicate, efface, terminate, extinguish, wish away, retouch out, rid the picture of, rid "
    "the frame of, free the scene of, free the shot of, free the picture of, scrub, scrub out, expunge, excise, eject, oust, "
    "obliterate, annihilate, say goodbye to, wave goodbye to, whisk away, spirit away, blot out, see off, remove from, shoo, "
    "despawn, exorcise, get shot of, remove, delete, erase, rm, del, yeet, nix, evict, vaporize, matte out, knock out, comp out, "
    "paint off, get rid of, eliminate, drop, lose, discard, scrap, trash, do away with, dump, ditch, clear, banish, scratch, kill, "
    "cut, purge, rid us of, clean out, take out, cut out, edit out, wipe out, rub out, throw out, throw away, take away, cut away, "
    "paint out, key out, clone out, crop out, pull out, kick out, chuck out, x out, leave out, rotoscope out, strip out, strip "
    "away, clear away, clear out, rub off, wipe off, edit away, carry off, wipe away, zap, nuke, yank, axe, bin, chuck, destroy, "
    "dispose of, dispense with, do without, exclude, omit, weed out, airbrush out, photoshop out, strike, toss, toss out, expel, "
    "shoo away, thanos snap, poof, unalive, boot out, deport, exile, deep six, vacuum up, wipe off the map, rip out, tear out, "
    "tear down, lop off, hack off, snip out, slice out, magic erase, magic eraser, content aware fill, heal out, inpaint, roto out "
    "and remove, demolish, dismantle, disintegrate, dissolve away, purge out, decommission, remove from the scene, get out of the "
    "way, send packing, rid the scene of, rid the shot of, cut from the scene, lift out and bin",
    "take": "clone stamp, clone, stamp, heal, patch, paint, brush, airbrush, retouch, photoshop, comp, matte, take, cut, throw, "
    "wipe, rub, edit, crop, get, kick, strip, clean, clear, chuck, leave, mask, erase, delete, remove, chop, pull",
    "hide": "stash, hide away, cover up, mask away, make go away, despawn, hide, conceal, mask, mask out, make invisible, "
    "vanish, disappear, stop showing, not show, blank out, switch off, turn off, cloak, veil, obscure, unshow, tuck away, make "
    "vanish, make disappear, suppress, camouflage, turn invisible, toggle off, disable, deactivate, ghost out, vanish out, "
    "render invisible, turn off the visibility of, shroud, screen off, black out of view, keep out of sight, take out of view, "
    "keep hidden, put out of sight, eclipse",
    "show": "show, reveal, unhide, turn on, switch on, toggle on, enable, reshow, bring back, restore, uncover, unmask, "
    "unveil, reappear, unghost, reinstate, put back, make visible, turn on the visibility of, display again, let show, bring "
    "into the open, resurrect, revive",
    "appear": "introduce, come into being, come into existence, come into the picture, key in, wipe in, reveal slowly, "
    "fade in, fade up, bring in, ease in, appear, emerge, materialize, come into view, show up, pop up, turn up, "
    "dissolve in, come in, pop in, arise, respawn, spawn in, fade into view, fade into the scene, fade onto the "
    "screen, blend in, dissolve into view, phase in, drift into view, beam in, teleport in, rez in, ghost in",
    "vanish": "key out slowly, wipe out slowly, wane, fade out, fade away, dissolve, fade, vanish slowly, disappear slowly, "
    "slowly vanish, slowly disappear, melt away, evaporate, peter out, fizzle out, dwindle away, fade off, get fainter and "
    "fainter, become fainter and fainter, grow fainter, get fainter, get more and more transparent, become more and more "
    "transparent, phase out, drift out of view, taper off, ghost away, beam out, rez out, fade from view, fade into nothing, "
    "fade to nothing, fade into thin air, dematerialize, die away, die out, ebb away, go transparent",
    "keep": "keep, show, show me, leave, retain, have, display, see, preserve, let me see, save, hold on to, spare",
    "isolate": "isolate, extract, single out, separate out, separate, cut free, solo, rotoscope, roto, crop to, cut around, "
    "rotobrush, lift from the background, cherry pick, pluck out, carve out",
    # places
    "move": "cheat, bounce, bung, scooch over, budge up, teleport, warp, snap, stack, balance, perch, seat, move, shift, push, "
    "put, slide, bring, pull, drag, place, shove, carry, send, scoot, nudge, translate, position, drive, displace, set, get, drop, "
    "throw, relocate, fly, float, slip, scooch, budge, transport, take, swing, draw, tug, bump, go, jump, drift, come, glide, "
    "wander, roll, hop, step, travel, walk, hover, swim, run, stand, sit, hang, lift, raise, lower, rise, sink, land, offset, "
    "reposition, ride, dance, skate, be, live, start, stay, haul, tow, boost, hoist, heave, lay, stick, park, plant, tuck, "
    "squeeze, lug, jog, jolt, shuffle, sneak, migrate, inch, edge, steer, sail, toss, fling, kick, yank, plop, set down, put down, "
    "pick up, scroll, pan, rest, belong, climb, crawl, creep, scoot over, shimmy, shuffle over, hustle over, lob, hurl, sling, "
    "plonk, plunk, drop off, wheel, ferry, tote, wiggle, jiggle, nudge over, push over, pull over, slide over, move over, shift "
    "over, bring over, set over, rearrange, reseat, rehome, resettle, repark, stow, situate, locate, deploy, dock, moor, hang up, "
    "stand up",
    "raise": "raise, lift, float, elevate, hoist, rise, levitate, lift up, raise up, pick up, ascend, take off, soar, float "
    "up, hover, jack up, prop up, boost up, push up, pull up, bring up, hang higher, send up, loft, lob up, fly up, rise up",
    "lower": "lower, sink, drop, descend, let down, bring down, drop down, set down, put down, duck, dip down, bring lower, "
    "push down, pull down, press down, hang lower, send down, bring to the ground, touch down",
    "rotate": "rotate, spin, revolve, pivot, swivel, twirl, whirl, twist, yaw, gyrate, whirl around, crank around, "
    "rotate round, spin around, spin round, revolve around, corkscrew",
    "turn": "swing, crank, turn, flip, swing round, swing around, wheel around, reorient, redirect, about face, whip "
    "around, whip round, spin round, swap round, twist around",
    "tilt": "barrel roll, angle, tilt, roll, lean, tip, bank, slant, incline, tip over, lean over, list, pitch, heel over, "
    "lean to the side, dutch, dutch tilt, skew over",
    "topple": "tip over, knock over, topple, topple over, keel over, tip, knock, push over, upend, overturn, lay on its side, "
    "knock down, flop over",
    "face": "face, look, point, head, turn, aim",
    "swap": "change their places, change their positions, switch their places, switch their positions, swap their "
    "places, swap their positions, exchange their places, trade their places, trade spots, swap spots, trade, flip positions, "
    "swap, exchange, switch, trade, interchange, swap places, change places, trade places, switch places, swap positions, swap "
    "around, swap round, change sides, switch sides, swap sides, swap over, switch around, exchange places, exchange positions, "
    "change positions, switch positions, flip flop, transpose, reverse the places of, reverse the positions of, turn around the "
    "places of, exchange the places of, rotate the places of, cross over, trade off, change over, switch out the places of",
    "match": "match, adapt, adjust, fit, equalize, color match, take on, take over, pick up, borrow, inherit, adopt, share, "
    "steal, harmonize, sync, blend, coordinate, imitate, emulate, tie in, unify, bring in line",
    # copies
    "copy": "instance, instantiate, array, photocopy, reproduce, copy, duplicate, clone, replicate, double up, copy and paste, "
    "copy paste, duplicate and paste, make copies of, make a copy of, make a duplicate of, make a clone of, mirror copy, "
    "photostat, xerox, shift d, cmd d, ctrl j, cmd j, alt drag, rubber stamp, spawn a copy of, duplicate up, mass copy, ctrl d, "
    "reduplicate, ghost copy, cookie cut",
    "add": "stack, line up, arrange, lay out, set up, distribute, scatter, comp, comp in, instantiate, instance, spawn, "
    "respawn, conjure, make, create, add, put, place, give, insert, produce, generate, set, have, get, want, show, "
    "need, stand, be, appear, duplicate, like, see, let, drop, spawn, bring in, throw in, stick, plant, park, prefer, send",
    "follow": "follow, come after, trail, chase, lag, lag behind, trail behind, run behind, run after, walk behind, come "
    "behind, follow behind, drive behind, drive after, go behind, go after, walk after, tag along behind, move behind, pursue, "
    "tag after, tag along, string along behind, come along behind, hang behind, straggle behind, lag after",
    "leave": "leave, echo, onion skin, have, make, add, put, give, create, draw, show, let, get, drag, apply, throw in, use, need",
    # time
    "freeze": "lock, lock in place, hit pause on, put on pause, put on hold, stop in place, stand frozen, keep frozen, freeze, "
    "pause, wait, halt, immobilize, stop moving, stand still, stay still, hold still, freeze frame, hold frame, keep still, stay "
    "put, hold in place, stay in place, stop dead, come to a stop, come to a halt, stop in its tracks, hold, petrify, arrest, "
    "come to a standstill, come to rest, bring to a stop, bring to a halt, bring to a standstill, stop, stun, hold up, put a stop "
    "to, hit the brakes on, put the brakes on, apply the brakes to, stop the motion of, stop the movement of, kill the motion of, "
    "kill the movement of, put a freeze on, apply a freeze to, do a freeze on, hold the position of, stop time for, time stop, "
    "hitpause, keep motionless, make stop, make a statue of, mannequin",
    "reverse": "run back, play in rewind, run in rewind, play it back, reverse, rewind, play backward, run backward, go "
    "backward, move backward, walk backward, invert in time, play back to front, run in reverse, play in reverse, go in reverse, "
    "backtrack, unwind, run it back, wind back, roll back, play the other way, send backward, send back in time, undo the motion "
    "of, turn back the clock on, flip in time, time reverse, reverse time for, rewind time for, go in rewind, boomerang back",
    "run": "play, run, go, move, walk, drive, dance, jump, ride, show, swim, fly, do, happen, roll, gallop, race, act, make, "
    "render, travel, trot, jog, hop, leap, skate, glide, float, sail, cruise, sprint, stroll, march, wander, stride, amble, crawl, "
    "climb, waddle, hover, pace, dash, dart, rush, whizz, tumble, prance, canter, scamper, scurry, swoop, paddle, pedal, cycle, "
    "drift, spin, turn, swing, fall, flow, pass, let, put, set, keep, have, replay, play back, be, get",
    "loop": "pingpong, loop, repeat, cycle, replay, keep repeating, keep looping, go round and round, boomerang, ping pong, keep "
    "cycling, keep on repeating, put on loop, put on repeat, play over and over, do over and over, replay over and over",
    "last": "squash, spread, condense, cram, take, last, stretch, stretch out, extend, expand, slow down, compress, squeeze, "
    "speed up, shorten, retime, lengthen, be, run, prolong, drag out, cut down, time stretch, stretch in time, make, "
    "get, time warp, time remap, draw out, spread out, pull out, elongate, protract, drag on, abridge, condense down, squish",
    # light
    "blur": "anonymize, anonymise, censor, haze out, blur, blur out, defocus, unfocus, soften, smudge, throw out of focus, "
    "put out of focus, unsharpen, smear, fuzz, smooth out, pixelize, mask with blur, bokeh, bokeh out, gaussian blur, lens "
    "blur, rack out of focus, rack focus off, soft focus, mist up, fog up, make blurry, make fuzzy, redact, de identify, "
    "deidentify, anonymize with blur",
    "glow": "bloom, light up like, glow, shine, light up, shimmer, sparkle, radiate, gleam, glisten, twinkle, glitter, beam, "
    "gleam up, emit light, radiate light, give off light, shine out, glow up, luminesce, be lit up, be aglow, light up from "
    "within, phosphoresce, fluoresce, beam out, gleam out, bling out, neon up",
    "apply": "chuck, stick, bung, plonk, whack, pop, smack, stuff, inject, breathe, infuse, lend, bring, add, apply, "
    "put, give, use, have, get, throw, make, want, need, set, create, lay, show, slap, surround, bathe, cast, like, "
    "see, place, wrap, let, deserve, do",
}
"""Sense -> the verbs that have it, in their first form."""


_NOUNS = {
    "delete": "deletion, removal, erasure, elimination", "copy": "duplication, cloning, replication",
    "rotate": "rotation, revolution", "enlarge": "enlargement, magnification", "shrink": "reduction in size",
    "brighten": "brightening", "darken": "darkening", "desaturate": "desaturation", "saturate": "saturation boost",
    "quicken": "acceleration, speed up, speed boost", "slow": "slow down, slowdown, deceleration, slow motion effect",
    "reverse": "reversal, inversion in time", "blur": "blurring, softening", "isolate": "isolation, extraction",
    "swap": "exchange, swapping", "vanish": "fade out, fade to nothing, disappearance", "appear": "fade in, fade up, appearance",
    "tint": "tinting", "warm": "warming", "cool": "cooling",
}  # fmt: skip
"""Sense -> nouns of what is done: "a 20 % reduction of the contrast"."""


def any_form(*senses: str) -> str:
    """The verbs of the senses in each of their forms and their nouns, as alternatives with `|`."""
    return "|".join((every_form(_verbs(senses)), *_nouns(senses)))


def asked_form(*senses: str) -> str:
    """As `any_form`, without that of what somebody does himself: "the dog takes off" wants nothing."""
    return "|".join((*(form for which in (1, 2) for form in inflected(_verbs(senses), which)), *_nouns(senses)))


def _nouns(senses: Sequence[str]) -> list[str]:
    nouns = [noun for sense in senses if sense in _NOUNS for noun in _NOUNS[sense].split(", ")]
    return [*nouns, *(f"{article} {noun} of" for noun in nouns for article in ("the", "a", "an"))]


def _verbs(senses: Sequence[str]) -> str:
    verbs = ", ".join(VERBS[sense] for sense in senses)
    return "|".join(dict.fromkeys(verb.strip() for verb in verbs.split(",")))


_NAMES_TOO = word_set(
    "light shade balloon scale mask cloak veil cut drop trash bin axe float duck face pump copy beam fuzz glitter"
)
"""Verbs that may be things as well."""
_RESERVED = (
    "more", "less", "brighten", "darken", "enlarge", "shrink", "quicken", "pace", "slow", "saturate", "desaturate", "mute", "cool",
    "scale", "delete", "hide", "raise", "lower", "rotate", "swap", "copy", "loop", "blur", "glow", "freeze", "reverse", "tint",
)  # fmt: skip
"""Senses whose verbs are no things."""
VOCABULARY.update(
    form
    for sense in _RESERVED
    for verb in VERBS[sense].split(", ")
    for form in (verb, *forms(verb))
    if " " not in verb and verb not in _NAMES_TOO
)
VOCABULARY.update(
    word_set(
        "animate teleport apply bathe colorize drench dye recolor repaint respray spray exposure contrast warmth "
        "saturation visibility vividness moved shifted pushed pulled placed dragged slid turned flipped faded painted "
        "made set put taken kept shown brought fewer wants wanted needs extra additional identical vibrance endlessly "
        "brightness luminance size sizes dimensions scale height width length speed pace tempo rate velocity "
        "repeatedly halve double triple treble quadruple radiate sheen halo aura"
    )
)
COMMAND_VERBS = frozenset(form.split()[0] for form in any_form(*VERBS).split("|")) - {"the", "a", "an"}
"""First words of the verbs of commands."""
IMPERATIVES: frozenset[str] = frozenset(verb.split()[0] for verbs in VERBS.values() for verb in verbs.split(", "))
"""Those with which a command begins: not "stands" of "the man who stands left"."""
