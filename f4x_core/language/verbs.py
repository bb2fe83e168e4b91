"""Verbs of edits by sense: one table, of which `any_form` makes the alternatives of a rule."""

from __future__ import annotations

from .grammar import VOCABULARY
from .lexicon import every_form, forms, word_set

VERBS: dict[str, str] = {
    # appearance
    "become": "highlight, try, try out, test, make, turn, render, change, convert, transform, give, paint, repaint, color, "
    "recolor, dye, spray, respray, spray paint, set, put, get, let, play, run, use, apply, do, keep, switch, bring, show, "
    "adjust, display, look, feel, become, have, go, seem, cover, coat, drench, dip, bathe, dress up, wrap, stain, shade, "
    "decorate, slap, splash, splatter, throw, smear, brush, lacquer, style, restyle, redo, colorize, tone, transition, "
    "morph, draw, pick, choose, select, add, sprinkle, lay, shift, swap, flip, restore, place, edit, modify, wear, ask "
    "for, go for, go with, opt for, fill, flood, soak, grade",
    "tint": "tint, tinge, tone, wash, stain slightly, suffuse, hint",
    "set": "dip, whack, set, change, make, turn, put, bring, adjust, take, get, give, have, need, show, apply, use, keep, "
    "correct, modify, tweak, fix, move, pull, push, dial, drag, slide, crank, pump, knock, ramp, kick, jack, tone, want, "
    "could use, can use, could do with, deserve, go, run, let, play",
    "more": "whack, increase, raise, boost, crank, push, pump, kick, jack, ramp, turn up, bump up, crank up, pump up, dial "
    "up, bring up, push up, strengthen, enhance, intensify, bump, lift, add, pull up, amplify, up, ramp up, jack up, beef "
    "up, heighten, hike, step up, punch up, take up, deepen, improve, extend, augment, multiply, advance, go up, grow",
    "less": "reduce, decrease, lower, turn down, knock back, pull, back off, roll off, bring back, cut, cut down, "
    "lessen, tone down, bring down, dial down, weaken, diminish, drop, take down, cut back, pull down, take back, pull "
    "back, dial back, ramp down, scale back, soften, ease, mute, knock down, step down, go down, minimize, tame, subdue, "
    "shrink, bump down, push down, limit, curb, moderate, attenuate, crank down, drag down",
    "brighten": "lift the exposure of, shed light on, lighten up, brighten, lighten, brighten up, lighten up, illuminate, "
    "light up, light",
    "darken": "darken, dim, darken down, dim down, black out, shade",
    "enlarge": "embiggen, biggen, scale it up, buff, beef up, enlarge, grow, magnify, scale up, blow up, upscale, upsize, "
    "expand, inflate, size up, swell, swell up, puff up, bulk up, balloon, bloat, supersize, pump up, widen, zoom up, "
    "double up, broaden, get bigger, get larger",
    "shrink": "minify, dwarf, nerf, shorten, shrink, scale down, shrink down, downscale, downsize, minimize, size down, contract, "
    "miniaturize, reduce, compress, get smaller, dwindle, squash down, deflate, cut down",
    "quicken": "fast forward, turbocharge, rev up, pick up the pace, pick up speed, speed up, accelerate, quicken, hasten, "
    "hurry, hurry up, rush, hustle",
    "pace": "retime, remap, time remap, speed ramp, time ramp, conform",
    "slow": "slow mo, ease down, slow down, slow, decelerate, brake, calm, calm down",
    "saturate": "boost the color of, punch up, saturate, enrich, liven up, enliven, perk up, spice up, vivify",
    "desaturate": "desaturate, decolor, decolorize, gray out, bleach out",
    "mute": "mute, dull, dull down, wash out",
    "warm": "warm, warm up",
    "cool": "cool, cool down, cool off, chill",
    "scale": "scale, resize, rescale, size",
    # visibility
    "delete": "scrub, scrub out, expunge, excise, eject, oust, obliterate, annihilate, say goodbye to, wave goodbye to, "
    "whisk away, spirit away, blot out, see off, remove from, shoo, despawn, exorcise, get shot of, remove, delete, erase, "
    "rm, del, yeet, nix, evict, vaporize, matte out, knock out, comp out, paint off, get rid of, eliminate, drop, lose, "
    "discard, scrap, trash, do away with, dump, ditch, clear, banish, scratch, kill, cut, purge, rid us of, clean out, "
    "take out, cut out, edit out, wipe out, rub out, throw out, throw away, take away, cut away, paint out, key out, clone "
    "out, crop out, pull out, kick out, chuck out, x out, leave out, rotoscope out, strip out, strip away, clear away, "
    "clear out, rub off, wipe off, edit away, carry off, wipe away, zap, nuke, yank, axe, bin, chuck, destroy, dispose of, "
    "dispense with, do without, exclude, omit, weed out, airbrush out, photoshop out, strike, toss, toss out, expel, shoo "
    "away",
    "hide": "stash, hide away, cover up, mask away, make go away, despawn, hide, conceal, mask, mask out, make invisible, "
    "vanish, disappear, stop showing, not show, blank out, switch off, turn off, cloak, veil, obscure, unshow, tuck away, "
    "make vanish, make disappear, suppress, camouflage, turn invisible, toggle off, disable, deactivate",
    "show": "show, reveal, unhide, turn on, switch on, toggle on, enable, reshow, bring back, restore, uncover, unmask, "
    "unveil, reappear",
    "appear": "key in, wipe in, reveal slowly, fade in, fade up, bring in, ease in, appear, emerge, materialize, come into "
    "view, show up, pop up, turn up, dissolve in, come in, pop in, arise",
    "vanish": "key out slowly, wipe out slowly, wane, fade out, fade away, dissolve, fade, vanish slowly, disappear "
    "slowly, slowly vanish, slowly disappear, melt away, evaporate, peter out, fizzle out, dwindle away, fade off, get "
    "fainter and fainter, become fainter and fainter, grow fainter, get fainter, get more and more transparent, become "
    "more and more transparent",
    "keep": "keep, show, show me, leave, retain, have, display, see, preserve, let me see, save, hold on to, spare",
    "isolate": "isolate, extract, single out, separate out, separate, cut free, solo, rotoscope, roto, crop to",
    # places
    "move": "scooch over, budge up, teleport, warp, snap, stack, balance, perch, seat, move, shift, push, put, "
    "slide, bring, pull, drag, place, shove, carry, send, scoot, nudge, translate, position, drive, displace, set, get, "
    "drop, throw, relocate, fly, float, slip, scooch, budge, transport, take, swing, draw, tug, bump, go, jump, drift, "
    "come, glide, wander, roll, hop, step, travel, walk, hover, swim, run, stand, sit, hang, lift, raise, lower, rise, "
    "sink, land, offset, reposition, ride, dance, skate, be, live, start, stay, haul, tow, boost, hoist, heave, lay, "
    "stick, park, plant, tuck, squeeze, lug, jog, jolt, shuffle, sneak, migrate, inch, edge, steer, sail, toss, fling, "
    "kick, yank, plop, set down, put down, pick up, scroll, pan, rest, belong, climb, crawl, creep",
    "raise": "raise, lift, float, elevate, hoist, rise, levitate, lift up, raise up, pick up, ascend, take off, soar, "
    "float up, hover",
    "lower": "lower, sink, drop, descend, let down, bring down, drop down, set down, put down, duck, dip down",
    "rotate": "rotate, spin, revolve, pivot, swivel, twirl, whirl, pirouette, twist",
    "turn": "turn, flip, swing round, swing around, wheel around",
    "tilt": "barrel roll, tilt, roll, lean, tip, bank, slant, incline, tip over, lean over, cant, list",
    "topple": "tip over, knock over, topple, topple over, keel over, tip, knock",
    "face": "face, look, point, head, turn, show, aim",
    "swap": "change their places, change their positions, switch their places, switch their positions, swap their places, "
    "swap their positions, exchange their places, trade their places, trade spots, swap spots, trade, flip positions, "
    "swap, exchange, switch, trade, interchange, swap places, change places, trade places, switch places, swap positions, "
    "swap around, swap over, switch around, exchange places, exchange positions, change positions, switch positions, flip "
    "flop, transpose",
    "match": "match, adapt, color match, take on, take over, pick up, borrow, inherit, adopt, share, steal, harmonize, "
    "sync, blend, coordinate",
    # copies
    "copy": "photocopy, reproduce, copy, duplicate, clone, replicate, double up, dup, dupe, copy and paste, copy paste, duplicate "
    "and paste, make copies of, make a copy of, make a duplicate of, make a clone of, mirror copy",
    "add": "spawn, respawn, conjure, make, create, add, put, place, give, insert, produce, generate, set, have, get, want, "
    "show, need, stand, be, appear, duplicate, like, see, let, drop, spawn, bring in, throw in, stick, plant, park, prefer",
    "follow": "follow, come after, trail, chase, lag, lag behind, trail behind, run behind, run after, walk behind, come "
    "behind, follow behind, drive behind, drive after, go behind, go after, walk after, tag along behind, move behind, "
    "pursue",
    "leave": "leave, echo, onion skin, have, make, add, put, give, create, draw, show, let, get, drag, apply, throw in, "
    "use, need",
    # time
    "freeze": "lock, lock in place, hit pause on, put on pause, put on hold, stop in place, stand frozen, keep frozen, "
    "freeze, pause, wait, halt, immobilize, stop moving, stand still, stay still, hold still, freeze frame, hold frame, "
    "keep still, stay put, hold in place, stay in place, stop dead, come to a stop, come to a halt, stop in its tracks, "
    "hold, petrify, arrest, come to a standstill, come to rest, bring to a stop, bring to a halt, bring to a standstill, "
    "stop",
    "reverse": "run back, play in rewind, run in rewind, play it back, reverse, rewind, play backward, run backward, go "
    "backward, move backward, walk backward, invert in time, play back to front, run in reverse, play in reverse, go in "
    "reverse, backtrack, unwind",
    "run": "play, run, go, move, walk, drive, dance, jump, ride, show, swim, fly, do, happen, roll, gallop, race, act, "
    "make, render, travel, trot, jog, hop, leap, skate, drift, spin, turn, swing, fall, flow, pass, let, put, set, keep, "
    "have, replay, play back, be, get",
    "loop": "loop, repeat, cycle, replay, keep repeating, keep looping, go round and round",
    "last": "squash, condense, cram, take, last, retime, stretch, stretch out, extend, expand, slow down, compress, "
    "squeeze, speed up, shorten, retime, lengthen, be, run, prolong, drag out, trim, cut down, time stretch, stretch in "
    "time, make, get",
    # light
    "blur": "anonymize, anonymise, censor, haze out, blur, blur out, defocus, unfocus, soften, smudge, throw out of focus, "
    "put out of focus, unsharpen, smear, fuzz, smooth out",
    "glow": "bloom, light up like, glow, shine, light up, shimmer, sparkle, radiate, gleam, glisten, twinkle, glitter, "
    "beam, gleam up, emit light",
    "apply": "add, apply, put, give, use, have, get, throw, make, want, need, set, create, lay, show, slap, surround, "
    "bathe, cast, like, see, place, wrap, let, deserve, do",
}
"""Sense -> the verbs that have it, in their first form."""


def any_form(*senses: str) -> str:
    """The verbs of the senses in each of their forms, as alternatives with `|`."""
    verbs = ", ".join(VERBS[sense] for sense in senses)
    return every_form("|".join(dict.fromkeys(verb.strip() for verb in verbs.split(","))))


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
        "animate teleport "
        "apply bathe colorize drench dye recolor repaint respray spray exposure contrast warmth saturation visibility "
        "vividness moved shifted pushed pulled placed dragged slid turned flipped faded painted made set put taken kept "
        "shown brought fewer wants wanted needs extra additional identical vibrance endlessly repeatedly halve double "
        "triple treble quadruple radiate sheen halo aura"
    )
)
