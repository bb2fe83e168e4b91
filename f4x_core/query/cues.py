"""What questions are made of: cues (question words, verbs, qualities), and which of them together ask for what."""

from __future__ import annotations

from ..language.courtesies import CALLS
from ..language.grammar import Rule, either, listed, table
from ..language.lexicon import every_form, word_set
from ..language.notation import Notation

WORDS: set[str] = set()
"""Every word of the cues: none of them is the name of a thing."""
_WALK = (
    "walk|run|swim|drive|fly|roll|ride|slide|float|jump|race|gallop|dance|jog|hop|crawl|sail|glide|spin|march|leap"
    "|drift|trot|stroll|sprint|rush|cruise|skate|paddle|waddle|stride|pedal|flow"
)
_PAST = {"ran": "run", "swam": "swim", "drove": "drive", "driven": "drive", "flew": "fly", "rode": "ride"}
COLOURS = word_set(
    "red orange yellow green blue purple violet pink brown black white gray beige golden silver gold turquoise cyan navy tan"
)


cue = Notation({}, WORDS)
"""The rule of a phrase without a value."""


_CUES = """
clips: (little|short|whole|entire) [clip|video|film|movie|footage|sequence|recording|scene|shot]
pictures: <.clips>|plate|comp|composition|picture|image|view|frame|room|world|screen|sight|reconstruction|field of view
noun:
    label|labels|word|words|name|names|class|classes|thing|things|object|objects|one|ones|item|items|element|elements|stuff|
    mover|of (them) all|of all (of them)
people: you|i|we|one|anybody|anyone|somebody|someone|the viewer
moments: time|times|moment|moments|second|seconds|(frame)
    number|frame|frames|point|points|instant|stage|timecode|timestamp|(time) [span|interval|period]
camera: the camera|camera|us|me|you|the viewer|viewer|the lens|the observer|here
filming: (the|my|our|this) camera
swivel: {=turn/pan/tilt/rotate/swivel} (around|round|left|right|up|down|to the left|to the right)
inside: [in|of|on|within|inside|during|over|throughout|through|for|from|across|into] (the|this|my|our|that|the whole|the
    entire|this whole|all of the) <.pictures>
see: see|found|{=find/spot/recognize/detect}|notice|make out|observe|look for
looking: (do|does|did|can|could|would) <.people> (can|could|get to|still get to) (ever|also|first|last|still|really|actually)
    <.see>|[have|has] (<.people>) got|got|[can|could] be [seen|found|spotted]
direction: left|right
in-view: in view|on screen|on the screen|on view|in sight|on camera|in shot
now: first|last|still|also|ever|actually|clearly
at: (at|in|on|from|since|until|to|by|during|for|between|over|around) (exactly|about|around|roughly) [which|what] (exact)
its: its|his|her|their|the
at-its: (at|in|reach|reaches|be|have|has|come|comes|get|gets) <.its> (very)|at|reach|reaches|be|have|has|come|comes|get|gets
plainly: dynamic|{=move/travel/come}|go|goes|going|went|came|in motion|on the move|[move|moves|moving] [around|about]|(<.its>)
    [movement|motion]|[has|have|having] (any) [motion|movement]
stands: {=stand/stay/remain/keep/lie/sit/hide}|sitting|painted|located|placed|found|situated|positioned
rest: <.stands> [where it is|where they are|in (one|its|the same) [place|spot]|on the spot]|(all) (of) (the)
    [static|stationary|motionless|unmoving|immobile|still|fixed] <.noun>|still|at
    rest|stationary|static|motionless|unmoving|immobile|resting|parked|idle|idling|at a standstill|standing (around)|<.stands>
    [still|stationary|static|motionless|put|at rest]|where it is|in place|not in motion|without moving
set-off: {=take off/lift off/depart}|start|starts|starting|started|begin|begins|beginning|began|set off|sets off|get
    going|gets going|set out|sets out
stop: {=stop/halt/pause/finish/cease/rest/end}|[come|comes|came] to (a) (full|complete|dead|total|sudden)
    [stop|halt|standstill|rest]|[stand|stands|stay|stays|remain|remains|standing|staying] still
big-er: more [big|large|wide|long|tall]|bigger|larger|wider|longer|broader|thicker|greater
small-er: smaller|tinier|narrower|littler
half: side|half|part|third|hand side
what: what|who|which|who and what|what and who|what all|[which|what] (single|kind of|kinds of|sort of|sorts of|other)
    <.noun>|which of [the|these|those|all the|them|all] (different) (<.noun>|two)|which of the two|the <.noun> [which|that]|what
    else|what (is) the <.noun>|what (is) (it) that|(the) [things|objects]
when: when (exactly)|after how [long|many seconds|many frames]|how [long|many seconds|many frames|much time|far] (does it
    take|is it|will it take|passes|pass) [until|before|into the <.clips>|into it]|from when ([to|until] when)|how [long|many
    seconds|many frames|much time] does it take (for)|until when|since when|how [early|soon|late]|[which|what] <.moments>
    [show|shows]|(at|in|on) (the) [moment|time|frame|instant|point|second] (number) [when|at which|in
    which|where|that|of]|(at) the [moment|frame|instant]|during [which|what] [part|parts|stretch|bit] (of the <.clips>)|what
    is the <.moments>|<.at> <.moments> (in time|of the clip|on)
where: show [me|us]|where (exactly|precisely)|whereabouts|where about|where abouts|locate|find|point
    out|[point|show|direct|lead] [me|us] to|(the) [position|location|place|whereabouts]|<.at>
    [part|side|half|place|position|corner|area|third|spot|location|region] (of the <.pictures>)
move: <.plainly>|{=head}|<.manner> (around|about)
takes: take|takes|taken|follow|follows|followed|along|<.move>
passes: {=pass/meet/reach/touch/cross/hit}|met|past|by|[<.move>|{=pass}] [past|by]|[{=pass}] [in front of|behind|over|under]
nearest: (<.at-its>) (the|its) (very) [nearest|closest|nearest of all] (point|position|<.noun>|together|approach)
farthest: (<.at-its>) (the|its) (very) [farthest|furthest|most distant|remotest] (away|apart) (point|position|<.noun>)
highest: (<.at-its>) (up) (<.its>) (very) [highest|top|apex|apogee|zenith|pinnacle|summit|crest|high point|{=peak}|maximum
    height|uppermost|topmost] (up) (point|position|place|spot|of all|[above|off] the ground|in the air)
farther-aside = left of: (further|farther|more|most) (to|on|at) (the) left
farther-aside = right of: (further|farther|more|most) (to|on|at) (the) right
place = in front of: (further|farther) [in front of|before|in front|ahead (of)]
place = behind: (further|farther) [behind|in back of]
place = above: higher (up)|above|over|higher than|on top of
place = below: below|under|beneath|underneath|lower (down)|lower than
place = left of: (further|farther) (to|on|at) (the) left (hand) (side) of|left from
place = right of: (further|farther) (to|on|at) (the) right (hand) (side) of|right from
place = near: next to|beside|near|near to|close to|alongside|around|by|adjacent to|nearby
side = left: (the) [leftmost|left most|far left|furthest left|farthest left] (<.noun>)|[to|on|at|in] (the) (far|very) left
    (hand) (<.half>) (of the <.pictures>)
side = right: (the) [rightmost|right most|far right|furthest right|farthest right] (<.noun>)|[to|on|at|in] (the) (far|very)
    right (hand) (<.half>) (of the <.pictures>)
side = middle: in the (very) [middle|center] (of the <.pictures>)|central|centered
on-side: (on|to|at|in) (the) <.direction> (<.half>)
sides: <.on-side> or <.on-side>
sideways-or: <.on-side> or <.on-side>
way: (in|to|into|from|toward) [which|what] (general) [way|direction|side|directions]|(the) [direction|heading] (of)|where to
compared: [in|with] relation to|relative to|compared [to|with]|with respect to|in comparison [to|with]|with regard
    to|(on|to|at) [which|what] side of
seen: (<.now>) [visible|seen|shown|present|spotted|recognizable|be seen|be found|to be seen|<.in-view>|out
    there|available|exist|exists|[appear|appears] [<.inside>|in it|in this|here|anywhere]|there
    (still)|here|around|somewhere|(somewhere|anywhere) <.inside>]|<.looking>|any sign
    of|[do|does] [we|you|it] have|[is|was] [it|this|that] (a) <.clips> of
staying: stay|stays|staying|remain|remains|remaining|last|lasts
visible: (<.now>) (<.staying>) [visible|(be) seen|shown|present|<.in-view>|to be
    seen|around|there|here|show|showing|shows]|<.looking> |(<.staying>) <.inside>|<.staying>
always: all along|all the while|[stay|stays|remain|remains|staying|remaining] [visible|in
    view|<.inside>]|always|constantly|permanently|continuously|(for|during) the [whole|entire] [time|way]|(for|during) all the
    time|at all times|throughout (the|this) (<.clips>)|(in|during|on) [all|every|each|all the] [frames|frame]|in every single
    frame|from start to finish|(for|during|through|over|in) the [whole|entire] <.clips>|(for|during|through|over|in) all of
    the <.clips>|from (the) [beginning|start] to (the) end
enter: {=appear/arrive/show up/turn up/pop up/emerge}|[{=enter/come into/come in/get into/step into}|<.manner> into]
    (the|this) (<.pictures>)
most-far: when [it|he|she|they] (is|are|was|were|get|gets) (the) [farthest|furthest] (away|apart)
most-far: (the) [maximum|max|greatest|largest|biggest|longest|highest] [distance|gap|separation|spacing]|(the) (very)
    [furthest|farthest] [apart|away]
hidden: hidden|invisible|covered|occluded|out of (the) [sight|view|frame|shot|the <.pictures>]|not (<.now>)
    [visible|seen|shown|there|in view|in sight|on screen]|off screen
gone: gone|no longer [<.inside>|there|here|around|visible]|(can|could|do) <.people> (can) no longer <.see>|not (<.now>)
    [<.inside>|there|here|around|visible|seen|<.in-view>] [any more|anymore|any longer]
leave: {=disappear/vanish/go away/go out/exit}|leave|leaves|leaving|(we|you|i) {=lose sight of}|[leave|leaves|leaving]
    (the|this) (<.pictures>)|left (the|this) <.pictures>|[{=exit/go out of/move out of/get out of/drop out of}|<.manner> out of]
    (the|this) (<.pictures>)
happens: ([describe|summarize|sum up|explain|outline]) what [happens|is happening|goes on|is going on|happened|takes place|is
    taking place|occurs] (here|there|to see)|what [changes|has changed|is changing|is different]|any action|the
    action|anything (interesting) [happening|going on]|anything happens
described: [describe|summarize|sum up|explain|outline] (what you see)|what (is) (the|this) <.clips>
    [about|shows|show|showing]|what is it (about)|what is this|what does [it|this|the <.clips>|this <.clips>] show|(a|an)
    (short|brief|quick) [summary|description|overview] (of)|what (can|could) you (can) [tell|say] (me) about [the|this]
    <.clips>
anybody: [anyone|anybody|someone|somebody] (else)
remain: left (over)|remaining
event: (during|in|of|at) <.its> [jump|leap|hop|flight|ride|run|walk|trick|turn|action|maneuver]
tag: or [not|no|nah|what]|(,) or|[for|in|at|on|to|of|from]|(,) [is|are|does|do|did|was|were|has|have|can] (not)
    [it|he|she|they|there|we|you]
remark: i|we|my|because|there
what-is-it: [what|which] (kind of|sort of|type of) (<.noun>) (is|are) [it|this|that|these|those|they] (<.noun>|is|are)
    (called)|[identify|classify] [it|this|that] (<.noun>)|what [did|have] i (just) [{=click/select/pick/mark}] (on)|what is
    selected|what am i looking at
contents: what am i looking at|what does (the|this) <.clips> [contain|show|include|consist of]|what (all) is (there) (to
    [see|edit]|<.inside>)|what are there|what do we have|what have we|what you (can) [see|know|have]|what there is (to
    see)|what is|a list|what (all) (is|are|can be) (to be) [seen|shown|visible|present|in view|on screen|available|known|in
    it]|the [contents|inventory]|[what|which] (all) (<.noun>) (do|have|can|could) <.people> (can|could|all)
    [<.see>|edit|have|know|change|select|ask about|work with|know of]|[which|what] (kinds of|sorts of|kind of) <.noun>
    (are|is|can be|do) (there|seen|visible|known|shown|present|found|exist|available)
filler: spend|spends|altogether|all together|in all|all
    told|directly|immediately|state|report|confirm|verify|establish|ascertain|specify|indicate|or
    [one|two|three|four|more|several]|would you say|do you [reckon|suppose|believe|figure]|if [the scale|it|that]
    [permits|allows]|[above|over|from] <.its> [starting|initial|original|first] [point|position|height|level]|is it
    [true|right|correct] that|am i [right|correct] (in thinking) that|[draw|trace|plot|show]
    (me|us)|<.inside>|<.event>|<.looking>|<.people> have|(that) <.people> (can|could) <.see>|have
    <.people>|still|doing|trace|draw|plot|compute|calculate|measure|estimate|determine|check| identify|report|<.its>
    <.pictures>|look|looks|seem|seems|appear|appears|[is|was] [it|this|that] [a|an|just|only]|would you
    [say|call|describe]|is|are|was|were|be|been|at
    all|being|does|do|did|has|have|had|having|,|-|:|'s|please|approximately|roughly|ever|about|anywhere|somewhere|right
    now|and|currently|if|if so|whether|that|quick question|know|i mean|over time|<.courtesy>|any|[can|could|would|will] you
    (please|kindly) (tell|show|say|find|give|point out) (me|us|out)|[tell|show|give] (me|us)|say|let me know|i wonder|i am
    wondering|i (just) [want|need] to know|i would [like|love] to know|do you know|any idea|do you have any idea|i am
    curious|question|do you happen to know|find out|work out|i ask myself|what i want to know is|do you think|would you
    say|according to you|describe|explain|in seconds|in frames|in here|in there|in this|in units (per second)|in pixels|in
    meters|[the|this] <.clips>|list|name|in it|of them|of all|at any time|at some point|at any [point|moment]
fast: how [fast|quick|quickly|slow|slowly|rapid|rapidly|speedy]|(at|with) [what|which] (kind of|sort of)
    [speed|velocity|pace]|(the) [speed|velocity|pace]|how much speed
extreme = max: (at) (<.its>) (very) [top|maximum|max|highest|greatest|peak|maximal]|at <.its> fastest|at most|at the most|at
    maximum
extreme = mean: (at) (<.its>) [average|mean]|on average|averaged|typically
extreme = min: (at) (<.its>) [lowest|minimum|least|min|minimal]|at <.its> slowest|at least|at minimum
far: how far|how much (ground|distance|way)|[what|which] (total|overall|entire|whole|full) [distance|length]|(the) total
    [distance|way]|(the) (total) distance [traveled|covered]|(the) [length|distance] of the
    [path|way|route|track|journey]|how long (is) (the) [path|way|route|journey]|how long a way|[what|which] [way|distance] in
    total|how many [meters|units|steps]
gap: (the) depth (of)|how deep (in (the) <.pictures>)|how [far|close|near] (away|apart|off|together)|(the) (current)
    [distance|gap|space|spacing|separation|clearance]|apart|how much [space|room|distance|gap]|how
    [big|large|wide|small|long] (is) (a|the) [gap|distance|space]|[what|which] [distance|gap|separation]|at [what|which]
    distance|how many units
least: (the|<.at-its>) [shortest|smallest|minimum|min|minimal|closest|least|nearest|lowest]|at the [closest|nearest]
    (point)|when [it|he|she|they] (is|are|was|were|get|gets|come|comes) (the) [closest|nearest] (together)
close: how [close|near]
get: come|comes|get|gets|getting|coming|approach|<.plainly>
together: together|apart|to each other|from each other|to one another|from one another|of each other|each other|away
big: how [big|large|small|long|tall|wide|high|broad|huge|tiny|thick]|[what|which] size|(the)
    [size|height|width|dimensions|extent]|how much (of the|of this|of) [<.pictures>|space|room]|what
    [part|share|fraction|percentage|proportion|portion|amount] of the [<.pictures>]|how many pixels
covers: {=cover/fill/occupy/take up/take}|appear|appears|look|looks|seem|seems|measure|measures
high: how high (up)|(to) [what|which|how much] height|how far up|how much height
rise: {=jump/rise/leap/climb/hop/ascend/lift/bounce/gain/reach/go/fly/get/move/come/lift off/take off}|rose|up|upward|off the
    ground
go-up: [{=leave}] the ground|[get|gets] off the ground|airborne|[{=go/move/get/bob}] up [or|and]
    down|{=rise/climb/ascend/leap/lift off/take off}|[{=go/move/get/come/fly/jump}] [up|upward]|rose|gain in height|gain
    height
jumps: {=jump/leap/hop/bounce}|[{=leave}] the ground|([get|gets]) off the ground|airborne|(up) in [mid|the] air|in midair
by-how-much: (by) how [much|far]
comes: come|comes|came
which-color: (of|in) [what|which] (for a|main|kind of|sort of|exact|precise) [color|colors|shade|hue|shades|tint|tone]
    (is|has|have|of|are in|is in)|[what|which] [shade|tone|tint|hue] of <.color> (is|has)|(the) [hex|rgb|color]
    [code|value|values] (of)|(the) (main|exact|dominant|average) [color|colors] (scheme|palette|of)|how colored
how-many: (count|tell) how many|how many (separate|different|single|distinct|individual|of the|of these|of them|of all
    the|of) (the)|(the) (total) [number|count] of|([can|could|would|will|do] you) (please) [count|tally|total] (up) (all)
    (of) (the)|what number of|[number|count|tally] (of)
frames: total frames|how many frames of [<.clips>|material]|frame count|(the) number of frames|how many
    [frames|pictures|images] (in total)|(the) total number of frames|the number of frames|what is the number of frames
rate: how many fps|[what|which] [frame rate|framerate|fps]|(the) [frame rate|framerate|fps]|how many [frames|pictures|images]
    [per|a|each|every] second|frames per second
how-long: (for) how [long|many seconds|many frames|much time]|how long in [seconds|frames]|for what time
duration: how many [seconds|minutes] (of [<.clips>|material])|(the) (total) [length|duration|running time|run time|runtime]
    (of)|(for) how long
clip: (the|this|my|our) (whole|entire) [<.clips>]|it|this|of (the|this) [<.clips>]|of it|in (the|this) [<.clips>]|there
lasts: cover|covers|last|lasts|run|runs|take|takes|go on|goes on|have|has|contain|contains|consist of|long|go
order: (in) [which|what] [order|sequence|succession]|in order|(in) the order|order|one after the other
sort: put|compare|{=order/sort/rank/arrange}|order|sort|list|name|rank|arrange|give|enumerate|what is the order of|the order
    of|put in order|in order
everything: all (that) <.people> (can) <.see>|everything (that) (<.people> (can) <.see>|you know|is there|there
    is)|everything|(all) (of) (the|these|those) [<.noun>|contents] (you know|that you know|you see|you can see|that are
    there|there are)|them all|what is there|what you see|them
first: first|last|(is|are) the [first|last] (one|thing|object) [to|that|which]|earliest|before all others
start: [<.set-off>|continue|continues|first] (to)
turn: [{=turn}] (around|round|back|left|right|to the left|to the right|the corner)|[{=change}] (its|his|her|the|their)
    [direction|course|way|directions|heading]|[make|makes|take|takes] a turn
nearer: closer|nearer|more near
farther: [farther|further] (away|back)|more distant
fastest: [at|with|have|has|reach|reaches|attain|attains|hit|hits|get to|gets to] (<.its>) [full|top|max|maximum|highest|peak]
    [speed|velocity]|(at) full [speed|gallop|sprint|throttle|tilt|pelt|pace|steam|blast]|(really|properly) [flying|going for
    it|flat out]|flat out|[speed|velocity] <.at-its> [maximum|highest|peak|greatest]|(<.at-its>) (<.its>) [fastest|quickest|top
    speed|highest speed|maximum speed|peak speed|speediest]
most: (the) [most|farthest|furthest]|(the) [greatest|longest|largest|most] [distance|way|ground|path]|(has|have) (the) most
    [motion|movement] (in it)|the largest [motion|movement|way]
more: more|farther|further|the most
biggest = biggest: [bigger|larger|taller|wider|longer]|(the) [more|most] [big|large|tall|wide|long|high] (<.noun>)|(the)
    [most|largest part|biggest part] of the <.pictures>|(the) (very)
    [biggest|largest|tallest|widest|longest|broadest|greatest] (<.noun>)|(the) [bigger|larger|taller] one (<.noun>)|(the) most
    [space|room|area|volume|mass]
biggest = smallest: [smaller|tinier|shorter]|(the) [more|most] [small|little|tiny|short] (<.noun>)|(the) (very)
    [smallest|tiniest|shortest|littlest|narrowest] (<.noun>)|the smaller one
brightest = brightest: (the) (very) [brightest|lightest] (<.noun>)|(the) [brighter|lighter] (one)
brightest = darkest: (the) (very) [darkest|dimmest] (<.noun>)|(the) [darker|dimmer] (one)
speediest = fastest: (the) [fastest|quickest|speediest] (moving) (<.noun>)|(the) [faster|quicker] (one)
speediest = slowest: (the) [slowest] (moving) (<.noun>)|(the) slower (one)
bigger = bigger: (much|the|a lot) <.big-er> (one|in size)|[{=take up/cover/fill/occupy}] (much) more
    ([space|room|area|ground]) (of the <.pictures>)
bigger = smaller: (much|the|a lot) <.small-er> (one|in size)
bigger = taller: (much|the|a lot) [more high|taller|higher] (one)
bigger = lower: (much|the|a lot) [shorter|lower] (one)
faster = faster: (much|the|a lot) [faster|quicker|speedier|more quickly|more rapidly] (one)|(at|with) (a)
    [higher|greater|more] speed
faster = slower: (much|the|a lot) [slower|more slowly] (one)
by-factor: how much|how many times|by how much|by what factor|by which factor|how many times as|what factor|to what
    degree|how much more
closing = closer: (any) [closer|nearer]|toward|approach|approaches|approaching|closer together|nearer together
closing = away: away from|[farther|further] [from|away|apart]|apart
around: [on|at|to] [either|both|each] [side|sides] of|[left|to the left] and [right|to the right] of|in the
    [vicinity|neighborhood|proximity] of|(close|right|directly) [next to|beside|near|close to|around|by|alongside|adjacent
    to|near to|surrounding|surrounds]|the neighbors of
whereto: where
sideways = left: (to|toward) (the) left (side)|leftward
sideways = right: (to|toward) (the) right (side)|rightward
along: in|to|along|into|toward|from
path: (along|trace|show|on|which|what|describe|by) (which|what) (the) [path|route|trajectory|course|track]
how: how
or-away: or [away|farther away|further away|<.move> (away|farther away)|not] (from <.camera>)
not: not|never|no longer|not ever|not an|not any
no: no|not|not an|not a|not any|never
any: (any|some) (other|else) [anything|something|anyone|anybody|somebody|someone|<.noun>] (else|other)|(else|other) <.noun>
but: apart from|besides|except|except for|other than|but|but not|excluding|not counting|without|aside from|beyond
anything: (is) (there) [anything|something]
do: do|does|doing|did|up to|behave|behaves|act|acts
list: list|name|enumerate|mention|inventory|what are|[tell|show|give] me (a) (list) (of)|a list of
ends-up: end up|ends up|end|ends|finish|finishes|arrive|arrives|land|lands|finally|in the end
at-last: finally|[in|at] the (very) end|at last|eventually
clip-length: is (the|this) [<.clips>]|does (the|this) [<.clips>] [last|run|take|go on]
by-what: by (their) [distance|depth|position|nearness|size]
crosses: {=cover}
what-it: what|what all
on: on|in|at
reaches: reach|reaches|reached|attain|attains|get to|gets to|get up to|gets up to
can: can|could
any-of: any|any of
order-by = from left to right: (from) left to right
order-by = from right to left: (from) right to left
order-by = from near to far: [closest|nearest] (one|ones|<.noun>) first|(from) near to far|from (the) [nearest|closest] to
    (the) [farthest|furthest|most distant]
order-by = from far to near: [farthest|furthest] (one|ones|<.noun>) first|(from) far to near|from (the) [farthest|furthest] to
    (the) [nearest|closest]
order-by = from front to back: (from) front to back
order-by = from back to front: (from) back to front
order-by = by size: [biggest|largest|tallest] (one|ones) first|by (their) size|from (the) [big|biggest|largest] to (the)
    [small|smallest]
order-by = from small to big: [smallest|littlest] (one|ones) first|from (the) [small|smallest] to (the)
    [big|biggest|large|largest]
order-by = by distance: (the) (in) depth order (of)|by (their) [distance|depth]|by how [far|near|close] they are
"""
"""Name, value (where it has one) and phrases. `<.name>`: what another line says; the rest as in `Notation`."""


def _read(text: str) -> dict[str, Rule]:
    verbs = {form: verb for verb in _WALK.split("|") for form in every_form(verb).split("|")} | _PAST
    shades = [f"{shade} {name}".strip() for name in sorted(COLOURS) for shade in ("", "light", "dark", "bright")]
    colour = table({name: name for name in shades}, vocabulary=WORDS)
    named = {
        "courtesy": CALLS,
        "manner": table(verbs, vocabulary=WORDS),
        "color": listed(colour, cue(",|or|, or")) >> (lambda found: " or ".join(one for (one,) in found)),
    }
    phrase = Notation(named, WORDS)
    for line in text.replace("\n    ", " ").strip().splitlines():
        head, _, spec = line.partition(": ")
        name, _, value = head.partition(" = ")
        rule = phrase(spec)
        rule = rule >> (lambda value=value: value) if value else rule
        named[name] = either(named[name], rule) if name in named else rule
    return named


CUES = _read(_CUES)

ROWS = """
what_is: what-is-it
frames: frames clip lasts | frames clip? lasts?
polar camera: filming move not?
polar camera manner=turn: filming swivel not?
polar camera says=not: filming rest not?
camera: how filming move | far filming move | how filming swivel | far filming swivel
long: how-long clip lasts? | how-long clip-length | duration clip? lasts?
order: sort? order? contents? everything? thing? by-what? us? order-by stands? comes? | order thing? everything? start?
    move? | who first start? move thing?
nearest_moment: when nearest thing together? | when nearest thing other | when least gap pair | when thing passes-by
farthest_moment: when farthest thing together? | when farthest thing other together? | when biggest gap pair
highest_moment: when highest thing? move?
fastest_moment: when fastest thing? move? lasts? | when speediest thing move?
when_turns: when turn thing start? | thing turn
@place: any place-of stands? | who place-of stands?
neighbours: who thing around
between: who pair stands? | any pair stands?
relation: where thing place-or stands? | where thing compared-to stands? | thing compared-to stands? | thing place-or
    stands? | who farther-aside thing stands?
where: thing sides stands?
polar relation: thing place-of stands? not?
distance extreme=max: most-far gap? thing other
distance extreme=min: close thing get together | least gap pair | least gap thing other
distance: gap thing other | gap pair | gap thing
compare_size: by-factor bigger thing other | who bigger thing
compare_size manner=bigger: big thing compared-to
polar compare_size: thing bigger other not?
polar compare_speed: thing faster other move? not?
polar nearest: thing nearer than us? not?
polar farthest: thing farther than us? not?
nearest: who nearer thing other | who nearest thing? other? stands? | nearest other?
farthest: who farther thing other | who farthest thing? other? stands?
most_moving: who move more thing? | who move most thing?
biggest: who biggest thing? but?
brightest: who brightest thing? but?
compare_speed: speediest but? | who move? speediest thing?
colour: which-color thing stands? comes?
polar colour: thing color not?
count_moving: how-many any? move but? seen? | how-many thing move start?
polar count_moving: any move but
polar count: more-than thing seen? | more-than thing spot
count: how-many thing doing | how-many thing seen? spot | how-many thing owner | how-many thing
    seen? side? stands? remain?
still: who not move start? always? | who rest always? stands? | anything rest stands? | anything not move
polar seen says=no: thing gone
polar leave: thing leave not?
polar enter: thing enter not?
polar enter thing=person: anybody enter
polar leave thing=person: anybody leave
approach: by-factor closing-to thing get other | thing closing-to move? get? or-away
polar approach: thing closing-to move? get? not?
polar rise manner=jump: thing jumps not?
rise manner=jump: when thing start? jumps | high thing jumps | how-long thing jumps
rise: thing go-up not? | high thing rise move? | by-how-much thing go-up
polar always says=no: thing hidden
polar stops: thing stop move? not?
polar stops says=no: thing always move not?
motion: who move start? but?
does: what-it do thing
fast: fast thing move? reaches? extreme?
path: path thing takes? | how thing get
where at=end: where thing stop | where thing ends-up | whereto thing move at-last
where at=start: where thing set-off
way: way thing turn | way thing move? takes? along? sideways-or? | thing move sideways-or | whereto thing move along?
    sideways-or?
polar way: thing move sideways not?
lasting: how-long thing move start?
seeing: how-long thing visible can?
size: big thing covers?
far: far thing move | far thing crosses | far thing get
stops: when thing stop move?
motion: when thing move start? | when thing set-off move?
enter: when start? thing enter
leave: when thing leave | when thing gone
seen: when thing visible can? | when thing hidden
polar still: thing rest not? always?
polar enter: anything enter
polar leave: anything leave
polar motion: thing plainly start? not? | thing manner start? not? | any plainly
polar always: thing seen? always not? stands? can?
where: where thing stands? seen? on?
polar side: thing seen? side stands? not?
polar seen thing=person: anybody seen?
polar seen: thing time | thing seen not? can? | no thing seen | any-of thing
things: list? contents seen? | described clip? | list everything seen?
happens: happens clip?
"""
