"""Phrases that can be meant in two ways or ask for what no edit does, and what is said of each."""
# ruff: noqa: F401  # phrases name what they are made of

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ..language.amounts import number
from ..language.grammar import Reading, Rule, here, literal
from ..language.lexicon import PICTURE
from ..language.notation import Notation
from ..language.times import duration, span
from .commands import QUALITIES
from .phrases import known_noun, known_thing

UNDO = "That may be an undoing: use `f4x undo SCENE`, or the button for it, or say what is to be removed."
_NEW = "Nothing new can be made; copies can, as in 'add another dog', and looks, as in 'make the dog look like ice'."
_WHOLE = (
    "Things are changed as a whole, and which of them is not said; say for example 'the left one' or 'all of them'."
)

_end = here(lambda reading, at: at >= len(reading.tokens) or not reading.tokens[at].is_word)
_will = here(lambda reading, at: not {"will", "might", "could", "may"}.isdisjoint(reading.words[at:]))
_first = here(lambda reading, at: at == 0)
_begin = here(lambda reading, at: at == 0 or not reading.word(at - 1).isalpha())
_more = literal("|".join(f"{one.more}|{one.less}" for one in QUALITIES))
_much = literal("|".join(f"{one.much}|{one.little}" for one in QUALITIES))
_length = span | duration | literal("half")
_say = Notation(globals())


def _reasons(phrases: Mapping[str, str]) -> tuple[tuple[Rule, str], ...]:
    """Return (rule, reason) of each phrase; `{words}` in a reason stands for what the phrase matched."""
    return tuple((_say(phrase), reason) for phrase, reason in phrases.items())


UNSURE = _reasons({
    "<_begin> [[scrap|kill|lose|axe|ditch|discard|ignore] [it|that|this] (all|one|again)|take it back|restore [everything|all]] "
    "<_end>|[deleted|removed] <.known_noun>": UNDO,
    "mute <.known_thing> <_end>": "A scene has no sound; say for example 'desaturate the car' if its colors are meant.",
    "used to [be|have|look|stand|move]|[[i am|we are] afraid|i fear] <_will>":
        "'{words}' tells what is not wanted, or how it was; say what is to be done.",
    "[tone|dial|take|knock|turn] [it|that|them|this] (down|back) [a notch|a bit|a touch|a little|a tad]":
        "'{words}' may be a place or an amount; say for example '20 % darker', or 'a bit down'.",
    "[<_first>|:] hold (the|its) [shadow|shadows|reflection|reflections] <_end>":
        "'Hold' may mean to freeze it or to leave it as it is; say 'freeze the shadow' or 'leave the shadow alone'.",
    "[start|resume|continue|unfreeze|release] [it|them|him|her] (again)":
        "'{words}' is for what was stopped; say for example 'freeze the dog from second 1 to 2'.",
    "[hide|hides|hiding] ![everything|anything|all|whatever|what] <.known_thing> [behind|under|underneath|beneath|inside|below]":
        "'Hide' may mean to place or to make invisible; say 'put the dog behind the bush' or 'make the dog invisible'.",
    "[fly|flies|flying] [off|away] !<known_thing>":
        "That may mean to move or to be gone; say 'move the bird away' or 'remove the bird'.",
    "turn off (the|all the|that|this) [lamp|lamps|light|lights|lantern|candle|headlights|sign|screen|tv] <_end>":
        "That may mean dark or gone; say 'make the lamp darker' or 'hide the lamp'.",
})  # fmt: skip
"""Questions that are asked even where a sentence could be carried out."""
NO_EDIT = _reasons({
    "[<.number>|half a] [m|cm|mm|ft|meter|meters|centimeters|inch|inches|foot|feet|yard|yards]":
        "A clip does not tell how long a metre or a foot is; say lengths in widths of the thing, for example "
        "'two widths to the left' or 'half its width up'.",
    "as <_much> as|[<_more>|[more|less] <_much>] than":
        "Things are not measured against one another; say how much it is to be, for example 'twice as big' or '20 % brighter'.",
    "undo|undid|redo|revert|restore|scrap|scratch|nvm|never mind|back|how it was|the way it was": UNDO,
    "camera|cam|stabilize|stabilization|deshake|shaky|zoom|dolly|crop|fov|lens|pan|orbit|reframe|close up|[closer|wider|tighter] "
    "shot|[top|side|aerial|back] view|from [another|a different] [side|angle|view]":
        "No camera is edited: `f4x render SCENE -o DIR` goes along paths of cameras (`--path stabilise`, "
        "`orbit`, a FILE), and so do cameras in Blender.",
    "[cut|remove|delete|trim|drop|chop|lose|clip|shave|shorten|keep only] (off|out|to|the|just|only) <._length> <_end>":
        "A clip keeps its length, so no time is cut out of it; `f4x render --frames` writes a part of it, and 'hide the "
        "dog until second 2' hides what is seen then.",
    "sound|music|audio|song|voice|bark|talk|sing|mute|unmute": "No edit makes '{words}': a scene has no sound.",
    "text|title|caption|captions|subtitle|subtitles|watermark|rain|snow|fog|confetti|sparks|hail": _NEW,
    "[add|insert|create|draw|write|put|place|give it|give me] [a|an|some]|replace|substitute": _NEW,
    "relight|relighting|sun|sunlight|spotlight|backlight":
        "The light is as it was filmed; it can be made brighter, darker, warmer or cooler.",
    "mirror|mirrored|horizontally|vertically|flop": "Nothing is mirrored; 'turn the dog around' lets it face the other way.",
    "longer|wider|thinner|shorter|fatter|slimmer|stretch|stretched|squash|squashed|narrower|thicker":
        "A thing grows as a whole; say for example 'make the dog bigger'.",
    "shiny|shinier|glossy|gloss|matte|sharpen|sharper|denoise|deblur|upscale|resolution|quality":
        "How a surface shines and how sharp a scene is are not changed; `f4x fit` with a finer profile may give more detail.",
    "wave|dance|smile|blink|wink|laugh|eat|sleep|fight|kiss|hug|breathe|somersault|backflip|jump higher|fly higher":
        "A thing moves as it was filmed; its motion can be slowed, reversed, frozen or moved along with it.",
    "morph|crossfade|[next|previous] [shot|scene|clip]":
        "A scene is one shot, and no thing turns into another; 'swap the dog and the cat' changes their places.",
    "export|save|render|download": "`f4x export`, `f4x render` and `f4x open` write files.",
    f"[align|level|snap|scale] (the|it|everything) ({PICTURE}) (to)":
        "Align to Floor, Scale to Length and Add Crop Box in Blender do that for a whole scene.",
})  # fmt: skip
"""The answer to a sentence that is not understood."""
UNCLEAR = _reasons({
    "better|nicer|prettier|beautiful|cinematic|moody|epic|awesome|interesting|stylish|professional|different|fancy":
        "It is not said what is to change, a color, brightness, contrast, size, place or speed?",
    "cartoon|oil painting|painting|sketch|pencil|anime|watercolor|pixelate|comic|vintage|vhs|noir|hologram|plastic|wood|stone|lego":
        "There is no such look; the looks are those of `f4x edits`, and black and white.",
    "[half|part|parts|most|some|a third|a quarter] of|the [second|third|fourth|fifth|next]": _WHOLE,
    "not|never": "Say what is to be done, not what is not: '{words}' is not understood here.",
})  # fmt: skip
"""The answer to one of which nothing can be left out, either."""


def reason_of(rows: Iterable[tuple[Rule, str]], reading: Reading) -> str:
    """Return the reason of the first row whose phrase occurs in a sentence; empty where none does."""
    for rule, reason in rows:
        for at in range(len(reading.tokens)):
            if ends := rule.at(reading, at):
                return reason.format(words=reading.text_of(at, max(max(ends), at + 1)))
    return ""
