"""Verbs of edits by sense: one table, of which `any_form` makes the alternatives of a rule."""

from __future__ import annotations

from collections.abc import Sequence

from .grammar import VOCABULARY
from .lexicon import every_form, forms, word_set

VERBS: dict[str, str] = {
    "become": "blush|flush|bleed|ripen|melt|mark|flag|accent|inject|breathe|snap|retint|lerp|interpolate|tween|ramp|"
    "blend|highlight|try|test|make|turn|render|change|convert|transform|give|paint|repaint|color|recolor|dye|spray|respray|"
    "set|put|get|let|play|run|use|apply|do|keep|switch|bring|show|adjust|display|look|feel|become|have|go|seem|cover|coat|"
    "drench|dip|bathe|wrap|stain|shade|decorate|slap|splash|splatter|throw|smear|brush|lacquer|style|restyle|redo|colorize|"
    "tone|transition|morph|draw|pick|choose|select|add|sprinkle|lay|shift|swap|flip|restore|place|edit|modify|wear|ask for|"
    "go with|fill|flood|soak|grade|reskin|retexture|recolorise|reshade|dunk|varnish|drape|steep|cloak|swathe|shroud|"
    "repurpose|slather|daub",
    "tint": "tint|tinge|tone|wash|suffuse|hint",
    "set": "clamp|peg|trim|dip|whack|set|change|make|turn|put|bring|adjust|take|get|give|have|need|show|apply|use|keep|"
    "correct|modify|tweak|fix|move|pull|push|dial|drag|slide|crank|pump|knock|ramp|kick|jack|tone|want|deserve|go|run|let|"
    "play",
    "more": "whack|increase|raise|boost|crank|push|pump|kick|jack|ramp|bump up|crank up|pump up|bring up|strengthen|"
    "enhance|intensify|bump|lift|add|amplify|up|heighten|hike|punch up|take up|deepen|improve|extend|augment|multiply|"
    "advance|grow|buff|gain up|exaggerate|accentuate|emphasize|magnify|maximize|elevate",
    "less": "shave|slash|slice|skim|chop|reduce|decrease|lower|turn down|pull|cut|lessen|bring down|weaken|diminish|"
    "drop|dial back|soften|ease|mute|minimize|tame|subdue|shrink|limit|curb|moderate|attenuate|nerf|dampen|suppress|"
    "understate",
    "brighten": "dodge|lighten up|brighten|lighten|brighten up|illuminate|light up|light|illumine|gain up",
    "darken": "darken|dim|shade|underexpose|overshadow",
    "enlarge": "embiggen|biggen|buff|enlarge|grow|magnify|scale up|upscale|upsize|expand|inflate|swell|swell up|"
    "balloon|bloat|supersize|pump up|widen|broaden|jumbo",
    "shrink": "minify|dwarf|nerf|shrink|scale down|downscale|downsize|minimize|contract|miniaturize|reduce|compress|"
    "dwindle|deflate|shrinkify|minimise|miniaturise|squish|half size",
    "quicken": "turbocharge|speed up|accelerate|quicken|hasten|hurry|hurry up|rush|hustle|undercrank|hyperlapse|"
    "time lapse|timelapse",
    "pace": "retime|remap|time remap|speed ramp|conform",
    "slow": "slow mo|slow down|slow|decelerate|brake|calm|overcrank|slomo|throttle|bullet time",
    "saturate": "punch up|saturate|enrich|enliven|vivify|boost the colors of",
    "desaturate": "desaturate|decolor|decolorize|gray out|drain the color out of|kill the color in|monochrome",
    "mute": "mute|dull|wash out",
    "warm": "warm|warm up",
    "cool": "cool|chill",
    "scale": "scale|resize|rescale|size",
    "delete": "cull|prune|eradicate|efface|terminate|extinguish|scrub|expunge|excise|eject|oust|obliterate|annihilate|"
    "remove from|shoo|despawn|exorcise|get shot of|remove|delete|erase|rm|del|yeet|nix|evict|vaporize|get rid of|"
    "eliminate|lose|discard|scrap|trash|ditch|banish|kill|purge|take out|throw away|take away|paint out|crop out|"
    "strip out|clear away|zap|nuke|yank|axe|bin|chuck|destroy|exclude|omit|toss|expel|thanos snap|poof|unalive|deport|"
    "exile|inpaint|demolish|dismantle|disintegrate|decommission",
    "take": "clone stamp|clone|stamp|heal|patch|paint|brush|airbrush|retouch|photoshop|comp|matte|take|cut|throw|wipe|rub|"
    "edit|crop|get|kick|chuck|leave|mask|erase|delete|remove|chop|pull|drop",
    "hide": "stash|despawn|hide|conceal|vanish|disappear|not show|turn off|cloak|veil|obscure|unshow|"
    "make disappear|suppress|camouflage|toggle off|disable|deactivate|shroud|eclipse",
    "show": "show|reveal|unhide|enable|reshow|restore|uncover|unmask|unveil|reappear|unghost|reinstate|resurrect|revive",
    "appear": "introduce|fade in|fade up|ease in|appear|emerge|materialize|show up|come in|arise|respawn",
    "vanish": "wane|fade out|fade away|dissolve|fade|vanish slowly|slowly disappear|melt away|evaporate|"
    "get fainter and fainter|get fainter|fade to nothing|dematerialize",
    "keep": "keep|show|show me|leave|retain|have|display|see|preserve|save|spare",
    "isolate": "isolate|extract|separate|solo|rotoscope|roto|rotobrush",
    "move": "cheat|bounce|bung|teleport|warp|snap|stack|balance|perch|seat|move|shift|push|put|slide|bring|pull|drag|"
    "place|shove|carry|send|scoot|nudge|translate|position|drive|displace|set|get|drop|throw|relocate|fly|float|slip|"
    "scooch|budge|transport|take|swing|draw|tug|bump|go|jump|drift|come|glide|wander|roll|hop|step|travel|walk|hover|swim|"
    "run|stand|sit|hang|lift|raise|lower|rise|sink|land|offset|reposition|ride|dance|skate|be|live|start|stay|haul|tow|"
    "boost|hoist|heave|lay|stick|park|plant|tuck|squeeze|lug|jog|jolt|shuffle|sneak|migrate|inch|edge|steer|sail|toss|"
    "fling|kick|yank|plop|scroll|pan|rest|belong|climb|crawl|creep|shimmy|lob|hurl|sling|plonk|plunk|wheel|ferry|tote|"
    "wiggle|jiggle|rearrange|reseat|rehome|resettle|repark|stow|situate|locate|deploy|dock|moor",
    "raise": "raise|lift|float|elevate|hoist|rise|levitate|ascend|soar|float up|hover|bring up|loft|fly up",
    "lower": "lower|sink|descend|bring down|duck",
    "rotate": "rotate|spin|revolve|pivot|swivel|twirl|whirl|twist|yaw|gyrate|corkscrew",
    "turn": "swing|crank|turn|flip|reorient|redirect",
    "tilt": "barrel roll|angle|tilt|roll|lean|tip|bank|slant|incline|list|pitch|dutch",
    "face": "face|look|point|head|turn|aim",
    "swap": "change their positions|trade spots|trade|swap|exchange|switch|interchange|change places|trade places|"
    "exchange places|transpose|exchange the places of",
    "match": "match|adapt|adjust|fit|equalize|borrow|inherit|adopt|share|steal|harmonize|sync|blend|coordinate|imitate|"
    "emulate|unify",
    "copy": "instance|instantiate|array|photocopy|reproduce|copy|duplicate|clone|replicate|copy and paste|"
    "make a copy of|photostat|xerox|shift d|reduplicate",
    "add": "stack|arrange|distribute|scatter|comp|instantiate|instance|spawn|respawn|conjure|make|create|add|put|place|"
    "give|insert|produce|generate|set|have|get|want|show|need|stand|be|appear|duplicate|like|see|let|drop|stick|plant|park|"
    "prefer|send",
    "follow": "follow|come after|trail|chase|lag|trail behind|drive behind|pursue",
    "leave": "leave|echo|have|make|add|put|give|create|draw|show|let|get|drag|apply|use|need",
    "freeze": "lock|freeze|pause|wait|halt|immobilize|stand still|freeze frame|hold frame|hold|petrify|arrest|stop|"
    "stun|hitpause|mannequin",
    "reverse": "reverse|rewind|go backward|walk backward|play in reverse|backtrack|unwind|time reverse",
    "run": "play|run|go|move|walk|drive|dance|jump|ride|show|swim|fly|do|happen|roll|gallop|race|act|make|render|"
    "travel|trot|jog|hop|leap|skate|glide|float|sail|cruise|sprint|stroll|march|wander|stride|amble|crawl|climb|waddle|"
    "hover|pace|dash|dart|rush|whizz|tumble|prance|canter|scamper|scurry|swoop|paddle|pedal|cycle|drift|spin|turn|swing|"
    "fall|flow|pass|let|put|set|keep|have|replay|be|get",
    "loop": "pingpong|loop|repeat|cycle|replay|boomerang",
    "blur": "anonymize|anonymise|censor|blur|blur out|defocus|unfocus|soften|smudge|unsharpen|smear|fuzz|pixelize|"
    "bokeh|gaussian blur|redact|deidentify",
    "glow": "bloom|glow|shine|light up|shimmer|sparkle|radiate|gleam|glisten|twinkle|glitter|beam|luminesce|"
    "phosphoresce|fluoresce",
    "apply": "chuck|stick|bung|plonk|whack|pop|smack|stuff|inject|breathe|infuse|lend|bring|add|apply|put|give|use|"
    "have|get|throw|make|want|need|set|create|lay|show|slap|surround|bathe|cast|like|see|place|wrap|let|deserve|do",
}
"""Sense -> the verbs that have it, in their first form."""


_NOUNS = {
    "delete": "deletion|removal|erasure|elimination", "copy": "duplication|cloning|replication",
    "rotate": "rotation|revolution", "enlarge": "enlargement|magnification", "shrink": "reduction in size",
    "brighten": "brightening", "darken": "darkening", "desaturate": "desaturation", "saturate": "saturation boost",
    "quicken": "acceleration|speed up|speed boost", "slow": "slow down|slowdown|deceleration|slow motion effect",
    "reverse": "reversal|inversion in time", "blur": "blurring|softening", "isolate": "isolation|extraction",
    "swap": "exchange|swapping", "vanish": "fade out|fade to nothing|disappearance", "appear": "fade in|fade up|appearance",
    "tint": "tinting", "warm": "warming", "cool": "cooling",
}  # fmt: skip
"""Sense -> nouns of what is done: "a 20 % reduction of the contrast"."""


def any_form(*senses: str) -> str:
    """Return the verbs of the senses in each form, and their nouns, as alternatives with `|`."""
    return "|".join((every_form(_verbs(senses)), *_nouns(senses)))


def asked_form(*senses: str) -> str:
    """Return `any_form` without the third person: "the dog takes off" asks for nothing."""
    return "|".join((every_form(_verbs(senses), stated=False), *_nouns(senses)))


def _nouns(senses: Sequence[str]) -> list[str]:
    nouns = [noun for sense in senses if sense in _NOUNS for noun in _NOUNS[sense].split("|")]
    return [*nouns, *(f"{article} {noun} of" for noun in nouns for article in ("the", "a", "an"))]


def _verbs(senses: Sequence[str]) -> str:
    return "|".join(dict.fromkeys("|".join(VERBS[sense] for sense in senses).split("|")))


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
    for verb in VERBS[sense].split("|")
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
IMPERATIVES: frozenset[str] = frozenset(verb.split()[0] for verbs in VERBS.values() for verb in verbs.split("|"))
"""Those with which a command begins: not "stands" of "the man who stands left"."""
