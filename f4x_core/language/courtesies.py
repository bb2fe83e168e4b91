"""Courtesies, reasons and remarks beside a command or a question, which add nothing to it."""

from __future__ import annotations

from collections.abc import Iterator

from .colour_names import COLOURS
from .grammar import Reading, generated, literal
from .lexicon import singular, word_set

CALLS = literal(
    "right now|immediately|at once|straight away|hey|hi|hello|okay|computer|dude|mommy|guys|team|boss|um|oh|well|so|now|then|"
    "next|also|as well|just|simply|actually|really|maybe|perhaps|probably|rather|for now|asap|for me|for us|[sort|fix] [it|that|"
    "this] (out)|from [that|this|the|there] ([point|moment]) ([on|onward])|if possible|if you [can|could|would|like|will|want]|"
    "if that is [okay|possible|fine]|when you [can|could|get a chance|have (a) [time|moment|minute]]|again|there|(in|around|over) "
    "[here|there]|altogether|all|exactly|nicely|(a) nice|lovely|kind of|sort of|you know (what)|[i|we] [think|guess|find|believe|"
    "reckon]|i am afraid|let us say|let me [think|see]|though|yeah|yes|overall|in total|first of all|finally|completely|entirely|"
    "fully|totally|out of the way|and stuff|or something|or so|of course|at the same time|(many) thanks (a lot|so much|in "
    "advance)|thank you (so much|very much|in advance)|cheers|sorry|excuse me|pardon me|by the way|btw|honestly|kindly|great|"
    "cool|perfect|nice (one)|good (job)|awesome|one (more|last) thing|last thing|next thing|[could|would|can|will] you"
)
"""Calls, thanks, interjections and hedges: they add nothing to an edit or a question."""
WISHES = literal(
    "[could|can|would|will] [you|somebody|someone|anybody|anyone|they]|[could|can|may|shall] [we|i] (get|have|see)|would you "
    "mind|do you mind|shall we|what if|what about|how about|[can|could|would|will] not [you|we|i]|how [do|can|would|could|does] "
    "[i|you|we|one] (go about)|why (do not you|not)|is there [a|any] way to|[is it|would it be] [possible|okay|fine|all right|"
    "cool|nice|great] (to|for|if [you|we|i])|(is there) any chance (of|that|you [can|could])|quickly|(i|we) [want|wanted|need|"
    "wish|prefer] (you)|(i|we) [would|should] (so|really|just|love) [like|love|prefer|rather|appreciate] (you) (to [see|have|"
    "get]|that|it if|if)|[i|we] would (rather have)|i wonder (about|if|whether)|[you|we] (really|just|probably) [should|could|"
    "can|may|must|ought to|had better|need to|have to]|let [us|me]|go (ahead) and|do not forget to|remember to|help me (to)|"
    "[make sure|ensure|see to it] (that)|so that|how to|feel free to|it is [necessary|required|important|essential] (to|that)|"
    "[i|we] [try|aim|intend|plan|seek] to|it would be [nice|great|cool|better|best] (if|to)|[start|begin|continue|go on|finish|"
    "end] (off|out|up) [by|with]|[give|get|show] me|[we|i] [am|are] (going|trying|hoping|looking|thinking) (to|for|of|that|"
    "after)|see|to see|[watch|look] (as|how|while)|have|to have|to get|want|need|[what|all] [i|we] (really|would|am|are) [want|"
    "need|like|love|after] is|imagine (that)|[i|we] [decided|figured|hope|suppose|suggest|thought|propose|say] (that|to)|[my|"
    "the] [suggestion|request|idea|wish|plan] is (that|to)|i would be [happy|glad|grateful] (if)|do me a [favor|favour] and|be "
    "so kind (as) to|be a [dear|love] and"
)
"""Wishes for an edit that do not say which."""
COMMENTS = literal(
    "(that|it|this|which|and that) [would|might|could|will|should] (really|surely) [be|look|seem|feel|do|work|read|go] (so much|"
    "much|way|a lot|even|just|really|very|pretty) [nice|nicer|good|better|best|great|cool|cooler|fun|lovely|perfect|awesome|fine|"
    "neat|sweet|amazing|well|the trick]|is (much|way) [nicer|better|cooler]"
)
"""Opinions on the wish."""
_because = literal(
    "because|cause|since|as [i|we|it is|they are]|in order to|as [if|though]|so (that) [i|we|you|one|people|everyone|nobody|it|the|"
    "our|my] |like [a|an|in|when|the|they|we|magic]|for [my|our]|for [clarity|effect|emphasis|fun|a change]|for the [client|look|"
    "mood]"
)
_OPENING = word_set(
    "i we my our it that this they he she you there because so since as like dear love thanks regards kind best cheers many in oh"
)
"""Words with which something may begin that is said beside the command, in a clause of its own."""
_MEANT = word_set(
    "should must shall could can would want wants need needs wish please make let has have except but only not no nothing "
    "second seconds frame frames half first last everything rest"
)
"""Words that a clause beside the command does not have."""
_SIGNS = word_set(", . ; : ! - ( )") | {""}


def _aside_at(reading: Reading, at: int) -> Iterator[tuple[int, None]]:
    """Yield the end of a reason, a comparison or a remark that names no thing, color or number, up to the next sign."""
    begins = [*_because.at(reading, at)] if at else []
    if reading.word(at) in _OPENING and (at == 0 or reading.word(at - 1) in _SIGNS):
        begins.append(at + 1)
    if not begins:
        return
    end = next(i for i in range(max(begins), len(reading.words)) if reading.words[i] in _SIGNS)
    words = {form for word in reading.words[at:end] for form in (word, singular(word))}
    things = {known[-1] for known in reading.known}
    if words.isdisjoint(_MEANT | things | COLOURS.keys()) and not any(word[:1].isdecimal() for word in words):
        yield end, None


ASIDE = generated(_aside_at)
