"""English that the grammar of edits needs: spellings, numbers, plurals, forms of verbs, words that are no things."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from functools import cache


def word_set(text: str) -> frozenset[str]:
    """Return the words of a text."""
    return frozenset(text.split())


def _table(text: str) -> dict[str, str]:
    """Return a dictionary from the first word of each entry to its others; entries have commas between."""
    return dict(entry.strip().split(" ", 1) for entry in text.split(","))  # type: ignore[misc]  # each has two parts


SPELLING = _table(
    "teh the, hte the, th the, te the, tha the, da the, ze the, tehe the, thee the, thr the, tthe the, adn and, nad and, annd "
    "and, & and, pls please, plz please, plese please, pleas please, colour color, colours colors, coloured colored, colouring "
    "coloring, colourless colorless, recolour recolor, recoloured recolored, recolouring recoloring, decolour decolor, grey "
    "gray, greys grays, greyscale grayscale, greyish grayish, greyer grayer, centre center, towards toward, till until, til "
    "until, onwards onward, ok okay, leftwards leftward, rightwards rightward, upwards upward, downwards downward, backwards "
    "backward, forwards forward, afterwards afterward, wanna want, colur color, coulor color, gonna going, gimme give, metre "
    "meter, metres meters, centimetre centimeter, centimetres centimeters, recognise recognize, summarise summarize, desaturise "
    "desaturate, colourise colorize, colourize colorize, colorise colorize, greyed grayed, u you, ur your, gotta to, tyre tire, "
    "tyres tires, neighbour neighbor, neighbourhood neighborhood, colourful colorful, favourite favorite, whilst while, thru "
    "through, travelling traveling, travelled traveled, wat what, wut what, wot what, dat that, dis this, dem them, ya you, yer "
    "your, r are, bg background, backround background, fg foreground, desat desaturate, vid video, vids video, pic picture, pics "
    "picture, cam camera, ppl people, dist distance, avg average, num number, <-> and, cuz because, coz because, cos because, "
    "bout about, n and, tho though, lil little, smol small, teensy tiny, eensy tiny, pos position, loc location, spd speed, dupe "
    "copy, dup copy, ctr center, cw clockwise, ccw counterclockwise, percents percent, bcuz because, em them, opac opacity, "
    "backgrnd background, foregrnd foreground, whichever which"
)
"""Common slips and British spelling -> the spelling that the grammar uses."""

_RGB = re.compile(r"(?:\brgb\b[ :=]*\(?|\() *(\d{1,3})[ ,;]+(\d{1,3})[ ,;]+(\d{1,3})\b *\)?", re.IGNORECASE)
"""A colour in three numbers: "rgb(255, 0, 0)"."""


def written(sentence: str) -> str:
    """Return the sentence with colors in three numbers as hexadecimal digits."""
    return _RGB.sub(lambda found: "#" + bytes(min(int(part), 255) for part in found.groups()).hex(), sentence)


_SHOT = re.compile(
    r"\s*((?!(?:frames?|fr|frm|secs?|seconds?|take)\d)[a-z]{2,}\d{2,}\w*|(?=[a-z_]*\d)[a-z]\w*_\w+|[a-z]\w*_\w+(?=\s+v\d)|"
    r"(?:shot|sh|seq|sq|scene)\s*#?\d+)(?:\s+v\d+)?(?:\s*[:,]|\s+[-–—])\s*",
    re.IGNORECASE,
)
"""The code of a shot before a note: "SH010:", "sq20_sh0030 -"; it has a digit, which "left_arm:" has not, and is no time."""


def without_shot(sentence: str, known: Collection[str] = ()) -> str:
    """Return a note without the code of its shot; "car_02: red" is about a car where that is one of the words and names `known`."""
    found = _SHOT.match(sentence)
    if found is None or found.end() == len(sentence):
        return sentence
    code, version = found[1].lower(), re.search(r"\sv\d", found[0])
    things = {word.lower() for word in known} & {code, *re.findall(r"^[a-z]+", code)}
    return sentence if things and not version else sentence[found.end() :]


_CONTRACTED = {
    "'s is": "that what where who there here when how why he she it whatever everything nothing",
    "'re are": "they you we what where who how there these those",
    "'ll will": "it that you they i we he she there",
    "'d would": "it that you they i we he she there",
    "n't not": "do does did is are was were has have had could would should must",
    "'ve have": "i we you they",
    "'m am": "i",
}
"""Ending and what it stands for -> words that it is joined to."""
_OTHERS = _table(
    "let's let us, can't can not, won't will not, shan't shall not, outta out of, kinda kind of, sorta sort of, lotta lot of, alot "
    "a lot, abit a bit, lemme let me, gimme give me, bnw black and white, bw black and white, semitransparent semi transparent, "
    "tryna trying to, dunno do not know"
)
_CUT = {
    stem + end.split()[0]: f"{stem} {end.split()[1]}" for end, stems in _CONTRACTED.items() for stem in stems.split()
}
_NO_CONTRACTIONS = word_set("its were ill well hell shell id shed wed whore")
CONTRACTIONS: dict[str, tuple[str, ...]] = {
    form: tuple(long.split())
    for short, long in (_CUT | _OTHERS).items()
    for form in (short, short.replace("'", ""))
    if form not in _NO_CONTRACTIONS
}
"""Words that stand for several, their apostrophe written or left out; any other `'s` is possessive."""

PLACES = 3
"""Decimals that numbers worked out from words keep."""
_ONES = (
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen "
    "eighteen nineteen"
)
_TENS = "twenty thirty forty fifty sixty seventy eighty ninety"
ONES = {word: i for i, word in enumerate(_ONES.split())}
TENS = {word: 10 * i for i, word in enumerate(_TENS.split(), start=2)}
ORDINALS = tuple("first second third fourth fifth sixth seventh eighth ninth tenth eleventh twelfth".split())  # noqa: SIM905
FRACTIONS = {"half": 1 / 2, "third": 1 / 3, "quarter": 1 / 4, "fifth": 1 / 5, "tenth": 1 / 10}

PLURALS = _table(
    "people person, persons person, men man, women woman, children child, kids kid, feet foot, teeth tooth, geese goose, mice "
    "mouse, oxen ox, policemen policeman, leaves leaf, wolves wolf, knives knife, shelves shelf, loaves loaf, calves calf, "
    "scarves scarf, halves half, lives life, wives wife, thieves thief, hooves hoof, potatoes potato, tomatoes tomato, heroes "
    "hero, shoes shoe, canoes canoe, toes toe, buses bus, lenses lens, vases vase, horses horse, houses house, roses rose, "
    "noses nose, hoses hose, cases case, suitcases suitcase, blouses blouse, axes axe, movies movie, cookies cookie, pies "
    "pie, ties tie, zombies zombie, selfies selfie, caches cache, aches ache, mustaches mustache, purses purse, nurses nurse"
)
"""Plurals that no rule gives."""
SYNONYMS = _table(
    "guy man, dude man, bloke man, fella man, fellow man, chap man, gentleman man, lady woman, gal woman, lad boy, kid child, "
    "kiddie child, kiddy child, toddler child, doggy dog, doggie dog, puppy dog, pup dog, doggo dog, pooch dog, kitty cat, kitten "
    "cat, bike bicycle, auto car, automobile car, motorbike motorcycle, loco locomotive, couch sofa, sofa couch, pony horse, calf "
    "cow, bull cow, vessel boat, lawn grass, foliage leaf, audience crowd, spectators crowd, pram stroller, buggy stroller, "
    "pushchair stroller, lorry truck, telly tv, television tv, aeroplane airplane, plane airplane, cab taxi, tram streetcar, hound "
    "dog, bunny rabbit, biker cyclist, lass girl, youngster child, tot child, infant baby, folks people, "
    "pavement sidewalk, seaside sea, birdie bird, ducky duck, duckie duck, horsie horse, horsey horse, piggy pig, froggy frog, "
    "fishy fish, onlooker person, bystander person, breakdancer dancer, ballerina dancer, trike bicycle, scoot scooter, individual "
    "person, pedestrian person, motorcar car, pickup truck, shrub bush, steed horse, mare horse, stallion horse, foal horse, ship "
    "boat, yacht boat, dinghy boat, settee sofa, roadway road, blossom flower, turf grass"
)
"""Another word -> the label that it means where a scene knows that, and not the word."""
SINGULARS = word_set(
    "trousers clothes stands bleachers stairs jeans shorts pants scissors glasses sunglasses headphones goggles tights "
    "lens series species news bus gas canvas christmas iris"
)
"""Words in s that stay as they are."""


def singular(word: str) -> str:
    """Return the singular of a noun in lower case, or the noun itself."""
    if word in PLURALS:
        return PLURALS[word]
    if word in SINGULARS or len(word) < 4 or not word.endswith("s") or word.endswith(("ss", "us", "is")):
        return word
    if word.endswith("ies"):
        return word[:-3] + "y"
    if word.endswith(("sses", "xes", "ches", "shes", "zzes")):
        return word[:-2]
    return word[:-1]


_PLURALS_OF = {one: many for many, one in reversed(PLURALS.items())}


def plural_of(noun: str) -> str:
    """Return the plural of a noun in the singular."""
    if noun in SINGULARS:
        return noun
    if noun.endswith("y") and noun[-2:-1] not in "aeiou":
        return noun[:-1] + "ies"
    return _PLURALS_OF.get(noun) or noun + ("es" if noun.endswith(("s", "x", "ch", "sh", "z")) else "s")


UNCOUNTED = word_set(
    "grass sand water snow ice ground floor sky sea ocean river lake road street path wall fence hair fur smoke fire dirt mud "
    "gravel pavement sidewalk field lawn foliage wood concrete background foreground furniture clothing traffic crowd audience "
    "team group pair couple family herd flock rain fog light shadow reflection food luggage ceiling roof platform mountain "
    "earth rock stone building plant leaf scenery skin text sunlight fog cloud water grassland beach"
)
"""Nouns in the singular that may be in several places at once: of "the grass" all of it is meant."""


def label_of(word: str, labels: Collection[str]) -> str:
    """Return the label that `word` is a synonym of, or `word`."""
    meant = SYNONYMS.get(word) or SYNONYMS.get(singular(word), "")
    return word if {word, singular(word)} & {*labels} or meant not in labels else meant


def spellings(word: str) -> list[str]:
    """Return `word` as a vocabulary may have it, likeliest first: in lower case, without its article, in the singular.

    "The Dogs" -> the dogs, dogs, dog.
    """
    plain = " ".join(word.lower().split())
    bare = re.sub(r"^(the|an?|any|some|this|that|these|those) ", "", plain)
    *first, last = bare.split() or [""]
    return list(dict.fromkeys([plain, bare, " ".join([*first, singular(last)])]))


_IN_LY = word_set(
    "fly family butterfly dragonfly lily jelly belly dolly trolley ugly lonely elderly early bully curly wooly woolly bubbly ally"
)


def is_adverb(word: str) -> bool:
    """Return True if a word ends as adverbs do and is no other."""
    return word.endswith("ly") and len(word) > 4 and word not in _IN_LY


_KEYS = ("qwertyuiop", "asdfghjkl", "zxcvbnm")
_BESIDE = {key: set(row[max(i - 1, 0) : i] + row[i + 1 : i + 2]) for row in _KEYS for i, key in enumerate(row)}
"""Letter -> those next to it on a keyboard; another letter makes another word: rider, river."""
_ALIKE = 0.85
"""Likeness of words of seven letters or more, two slips apart at most."""


def _slipped(word: str) -> set[str]:
    """Return what fingers make of a word: two letters swapped, or one missing, too many or next to the right one."""
    cuts = [(word[:i], word[i:]) for i in range(len(word) + 1)]
    swapped = {a + b[1] + b[0] + b[2:] for a, b in cuts if len(b) > 1}
    missing = {a + b[1:] for a, b in cuts if b}
    beside = {a + key + b[1:] for a, b in cuts if b for key in _BESIDE.get(b[0], ())}
    return (swapped | missing | beside | {a + key + b for a, b in cuts for key in _BESIDE}) - {word}


def is_slip(word: str, other: str) -> bool:
    """Return True if fingers slipped: two letters are swapped, or one is too many or missing, within a word of five or more."""
    within = word[:1] + word[-1:] == other[:1] + other[-1:] and min(len(word), len(other)) > 4
    return within and other in _slipped(word) and (sorted(word) == sorted(other) or len(word) != len(other))


def misspelt(word: str, known: Iterable[str]) -> str | None:
    """Return the word of `known` that was probably meant: one slip away, or nearly alike from seven letters on."""
    if len(word) < 4:  # of short words only those with two letters swapped
        return next((other for other in sorted(known) if other != word and sorted(other) == sorted(word)), None)
    near = sorted(other for other in _slipped(word).intersection(known) if len(other) > 3)
    alike = get_close_matches(word, {*known} - {word}, 1, _ALIKE) if len(word) > 6 and not near else ()
    return next(iter((*near, *alike)), None)


def plural(noun: str, count: float) -> str:
    """Return `noun`, with an s unless `count` is 1: "edit" -> "edits"."""
    return noun if count == 1 else f"{noun}s"


PICTURE = (
    "scene|picture|image|video|clip|shot|footage|movie|film|frame|view|sequence|photo|photograph|composition|comp|screen|"
    "recording"
)
"""Words for what is seen."""
SETTING = (
    "park|street|garden|yard|field|meadow|forest|woods|bedroom|kitchen|city|town|village|beach|playground|stadium|arena|hall|"
    "studio|gym|zoo|desert|countryside"
)
"""Words for where all that is seen is: they tell no thing from another."""
EVERYBODY = ("person", "people", "human")
PEOPLE = (
    r"person|people|humans?|[a-z]*m[ae]n|[a-z]*wom[ae]n|child(?:ren)?|kids?|bab(?:y|ies)|boys?|girls?|guys?|lad(?:y|ies)|faces?|"
    r"hands?|(?:bicycl|motorcycl|cycl|art|tour|guitar|pian|viol)ists?|ballerinas?|skaters?|surfers?|jockeys?|nurses?|"
    r"(?:horse |bike )?(?:rid|driv|danc|runn|swimm|walk|work|play|passeng|teach|farm|soldi|paint|conduct|act|sail|sing|act|wait|"
    r"danc|box|climb|jump|skat|surf|wrestl|referee|fight|photograph|bik)(?:er|or)s?|passengers?|soldiers?|tracers?|athletes?|"
    r"cyclists?|pilots?|doctors?|cooks?|chefs?|brides?|grooms?|students?|kings?|queens?|boss(?:es)?|friends?|pedestrians?"
)
"""Names of people, as a pattern."""
"""The label that "everyone" means: the first of these that a scene knows."""

_FORMS = _table(
    "make making made, take taking taken, give giving given, hide hiding hidden, freeze freezing frozen, show showing "
    "shown, keep keeping kept, hold holding held, put putting put, cut cutting cut, set setting set, let letting let, get "
    "getting got, lose losing lost, bring bringing brought, slide sliding slid, spin spinning spun, shrink shrinking "
    "shrunk, grow growing grown, run running run, leave leaving left, blow blowing blown, throw throwing thrown, rise "
    "rising risen, stand standing stood, dye dyeing dyed, see seeing seen, have having had, go going gone, fly flying "
    "flown, swim swimming swum, drive driving driven, wipe wiping wiped, rewind rewinding rewound, tie tying tied, speed "
    "speeding sped, lie lying lain, send sending sent, fall falling fallen"
)
"""Verb -> "-ing" form and participle, where the rules do not give them."""
_DOUBLED = word_set(
    "cap peg hop jog lag snap slip pop zip pin stop drop flip trim scrap chop drag tag dim tip strip swap wrap"
)


def forms(verb: str) -> tuple[str, str]:
    """Return ("-ing" form, participle) of a verb."""
    if verb in _FORMS:
        ing, participle = _FORMS[verb].split()
        return ing, participle
    if verb in _DOUBLED:
        return verb + verb[-1] + "ing", verb + verb[-1] + "ed"
    if verb.endswith("e"):
        return verb[:-1] + "ing", verb + "d"
    if verb.endswith("y") and verb[-2] not in "aeiou":
        return verb + "ing", verb[:-1] + "ied"
    return verb + "ing", verb + "ed"


@cache  # many commands share their verbs
def _conjugated(phrase: str) -> tuple[str, str, str, str]:
    """Return a verb with what follows it as (plain form, "-ing" form, participle, third person)."""
    head, *rest = phrase.split()
    ing, participle = (" ".join([form, *rest]) for form in forms(head))
    return " ".join([head, *rest]), ing, participle, _stated(phrase)


def _stated(verb: str) -> str:
    """Return the third person of a verb: "the dog vanishes", "the dog turns around"."""
    head, *rest = verb.split()
    form = {"not": "does", "be": "is", "have": "has"}.get(head, head)
    if form == head:
        form = head[:-1] + "ies" if head.endswith("y") and head[-2] not in "aeiou" else head
        form += "" if form != head else "es" if head.endswith(("s", "sh", "ch", "x", "o")) else "s"
    return " ".join([form, *(["not"] if head == "not" else []), *rest])


def every_form(verbs: str, stated: bool = True) -> str:
    """Return the verbs of "get rid of|remove" in each form, as alternatives with `|`; without "removes" if not `stated`."""
    forms_of = (_conjugated(phrase)[: 3 + stated] for phrase in verbs.split("|"))
    return "|".join(dict.fromkeys(form for phrase in forms_of for form in phrase))


NO_THINGS = word_set(
    "file files folder directory disk drive database system password prompt instruction instructions rule rules code script "
    "program command commands server computer software user account data edit edits change changes history step sound sounds audio "
    "music song voice noise text word words sentence subtitle caption title camera lens zoom view viewpoint angle frame frames "
    "second seconds minute minutes time speed size width height length color colors hue side sides brightness opacity transparency "
    "saturation contrast job world universe internet something nothing anything nobody somebody someone anyone everyone everybody "
    "everything way lot bit kind sort fun problem idea question answer life love nonsense stuff overall volume weather mood heat "
    "temperature day morning evening night afternoon pirouette somersault backflip frontflip cartwheel handstand headstand "
    "moonwalk curtsy empty"
)
"""Nouns that name nothing one can see in a scene."""
FUNCTION_WORDS = word_set(
    "a an the and or but nor so if when while because unless whether though although as than that which who whom whose "
    "what where why how is are was were be been being am do does did done doing have has had having will would shall "
    "should can could may might must ought not no never none nothing nobody i you we he she they me him us them my your our "
    "his her its their mine yours ours this these those there here to of in on at by for from with without into onto over under "
    "above below between among behind beside beneath through across along around about against toward up down out off "
    "away back left right upon near next again also too very really quite rather just only even still already yet ever "
    "always almost maybe perhaps please some any every each all both either neither more most less least much many few "
    "several other another same such own else then now later before after until since during within once twice thrice "
    "let us s t forget ignore pretend disregard except yes sure hello hi hey thanks sorry"
)
"""Words that bind others; none is part of a thing's name."""


WHICH = {
    "top left|upper left|upper left hand": "top left",
    "top right|upper right|upper right hand": "top right",
    "bottom left|lower left|lower left hand": "bottom left",
    "bottom right|lower right|lower right hand": "bottom right",
    "left|leftmost|left most|left hand|far left": "left",
    "right|rightmost|right most|right hand|far right": "right",
    "top|topmost|upper|uppermost|highest|top most": "top",
    "bottom|bottommost|lower|lowest|bottom most": "bottom",
    "middle|central|center|centermost|middlemost": "middle",
    "nearest|closest|front|frontmost|foremost|nearer|closer|foreground": "nearest",
    "farthest|furthest|farther|further|back|rear|hind|rearmost|most distant|backmost|hindmost": "farthest",
    "biggest|largest|bigger|larger|tallest|longest|taller": "largest",
    "smallest|tiniest|littlest|smaller|shortest|shorter": "smallest",
}
"""Words that pick one of several things -> its place or size (`edit.selects.Instance`)."""
