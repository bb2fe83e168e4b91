"""What a sentence holds beside the command and adds nothing to it: politeness, reasons, comparisons, somebody's name.

Each is told by its class and its place, whatever its words are, and ends where the command could go on.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from .grammar import VOCABULARY, Token, either, literal, tokenise, unless
from .lexicon import FUNCTION_WORDS, singular, word_set

CALLS = literal(
    "i am afraid|i fear|you know what|let us say|right now|immediately|at once|straight away|this instant|i do not know|do not "
    "know|hey|hi|hello|okay|alexa|siri|google|computer|assistant|buddy|mate|dude|mummy|mum|mom|mommy|mama|dad|daddy|papa|grandma|"
    "grandpa|my friend|sir|um|umm|uhm|uh|er|erm|hmm|oh|well|so|now|then|next|also|as well|just|simply|actually|really|maybe|"
    "perhaps|probably|rather|somehow|for now|right away|asap|for me|for us|[sort|fix] [it|that|this] (out)|do something about [it|"
    "that]|from [that|this|the] [point|moment] (on|onward)|from there (on|onward)|if possible|if you [can|could|would|like|will]|"
    "when you can|again|there|in [here|there]|around here|here|over there|altogether|all|full on|exactly|properly|nicely|(a) nice|"
    "lovely|kind of|sort of|you know|after all|i think|i guess|i feel like|i believe|[i|we] find|i would say|let me [think|see]|"
    "this time|from there|in one go|of course|though|yeah|yes|preferably|by preference|overall|in total|all in all|first of all|"
    "firstly|secondly|thirdly|finally|at last|completely|entirely|fully|totally|the [heck|hell|crap|shit|life] out of|and stuff|or "
    "something|out of the way|in addition|at the same time|on top of [that|this]"
)
"""Calls, interjections and hedges: they add nothing to an edit or a question."""
ASKS = literal(
    "[could|can|would|will] [you|somebody|someone|anybody|anyone|they]|[could|can|may|shall] [we|i] (get|have|see)|would you "
    "mind|do you mind|shall we|what if|what about|how about|why not|how [do|can|would|could|does] [i|you|we|one] (go about)|"
    "is there [a|any] way to|[is it|would it be] [possible|okay|fine|all right|cool|nice|great] (to|if [you|we|i])|see (your|"
    "their) way (clear) to|(is there) any chance [you|we] could|(is there) any chance (of|that|you [can|could])"
)
"""Wishes that are put as questions."""
WISHES = either(
    literal(
        "quickly|[i|we] [want|wanted|need|wish|prefer|fancy]|(i|we) [would|should] (so|really|just|absolutely|totally|dearly|"
        "quite) [like|love|prefer|rather|sooner] (to [see|have|get]|that|it if)|[i|we] would [end|start|finish|begin|open] [on|"
        "with]|i wonder (about)|[i|we] would rather have|(i want|i would like|i need) you|[you|we] (really|just|probably) [should|"
        "could|can|may|must|ought to|had better|need to|have to]|let us|let me|go (ahead) and|(i|we|do) not forget to|remember to|"
        "try to|help me (to)|[make sure|ensure|see to it|be sure] (that)|so that|in such a way that|how to|feel free to|it is "
        "[necessary|required|needed|important|essential|vital|crucial|imperative] (to|that)|[i|we] [search|try|aim|intend|plan|"
        "seek] to|[i|we] can not [figure out|work out|find out|find|see] how to|it would be [nice|great|cool] (if)|if only|"
        "consider|[start|begin|continue|go on|carry on|finish|end] (off|out|up) [by|with]|your [job|mission|goal] is to|[would|"
        "will|are|could|can|might] you (be) [able|manage] to|give me|get me|show me|i am looking for|i am trying to|[we are|i am] "
        "going to|your task is to|time to|see|to see|[watch|see|observe|notice|witness|behold|look] (as|how|while)|have|to have|to "
        "get|want|need|would like|[what|all] [i|we] (really|would|am|are) [want|need|like|love|after|picture|ask for] is|it [is|"
        "would be] (much|way) [better|best|nicer] (if|to)|[see|check] if you can|imagine (that)"
    ),
    literal("[i|we] would") + unless(literal("like|love|prefer|rather|want|have|be|do|not|sooner")),
    literal(
        "[i|we] [was|am|were|are|have been] (just|also) [thinking|wondering|hoping|imagining|picturing] (about|of|if|that|"
        "whether)|[i|we] (have) (now|just|finally) [decided|concluded|determined|resolved|agreed|settled|chosen] (that|to|on)|"
        "[i|we] (can|do) [trust|insist|demand|require|request|expect|vote|gather|assume|presume|recommend|advise] (that|for|"
        "you)|[i|we] [figured|imagine|picture|imagined|hoped|hope|reckon|suppose|suggest|thought|propose|say] (that)|(i|we) "
        "[am|are] after|[my|the] [suggestion|request|thought|vision|dream|goal|task|job|wish|idea|plan] [is|would be] (that|"
        "to)|[i|we] would be [happy|glad|grateful|thankful] (if)|i [bet|dare say]|in [my|our] opinion"
    ),
)
"""Requests and wishes."""
_NICE = (
    "nice|nicer|good|better|best|great|cool|cooler|fun|funny|lovely|perfect|awesome|fine|ideal|neat|sweet|pretty|prettier|amazing|"
    "brilliant|wonderful|super|enough|nicely|well|cute|adorable|hilarious|sick|dope|epic|rad|fantastic|terrific|"
    "gorgeous|ace|stunning|decent|interesting"
)
COMMENTS = either(
    literal("(that|it|this|which|and that) [would|might|could|will|should]")
    + literal(
        "(really|surely|definitely|also|probably|certainly) [be|look|seem|feel|do|work|sell|read|come across|show|go|suit|fit]"
    )
    + ~literal("so much|much|way|a lot|even|just|really|very|far|pretty")
    + literal(_NICE + "|the trick")
    + ~literal("to [see|have]|if|there|here"),
    literal("[is|are|was|were] (much|way|a lot) [nicer|better|cooler|prettier]"),
)
"""What somebody thinks of the wish."""
_CALLED = (
    r"(?:my )?(?:love|darling|dear|dearie|dearest|honey|hon|sweetie|sweetheart|babe|pal|mate|buddy|bro|bruh|dude|boss|chief|"
    r"friend|sir|madam|ma am|guys|folks|team|everyone|everybody|computer|assistant|old chap|old boy|quick|quickly|asap|"
    r"pronto|stat|now|then|already|would you|will you|could you)"
)
"""Who is called behind a comma, or hurried."""
_UNTIL = r"(?=\s*(?:[.;!?,:]|$| and | then ))"
_POLITE_WORDS = (
    r"is|are|be|would|could|can|will|may|might|do|does|did|not|possible|okay|alright|right|fine|cool|mind|like|want|please|"
    r"so|kind|good|nice|enough|able|to|me|us|for|with|all|at|too|much|trouble|bother|a|an|any|the|problem|work|works|manage|that|"
    r"this|it|you|i|we|way|have|time|get|chance|moment|minute|second|feel|wish|prefer|need|know|how|there|help|sure|"
    r"somehow|ask|must|anyhow|doable|say|easy|hard|agree|allowed|no|big|deal|permit|only|makes|sense"
)
_OPENING = (
    r"(?:ok|okay|all right|alright|cool|great|perfect|awesome|nice(?: one)?|good(?: job| work)?|well done|fine|super|excellent|"
    r"lovely|brilliant|wonderful|amazing|sweet|very good|got it|sounds good|beautiful|not bad|next(?: up)?|much better|i see|right)"
)
_WISHING_WORDS = (
    "mean|means|lot|world|favor|favour|beg|command|order|request|hereby|told|said|insist|propose|suggest|recommend|hurry|if|"
    "why|i|we|you|it|that|there|one|who|somebody|someone|would|could|might|may|can|will|shall|should|am|is|was|were|be|been|"
    "being|do|does|did|have|has|had|not|never|like|love|prefer|want|wanted|need|wish|hope|hoping|hoped|wonder|wondering|"
    "wondered|thinking|think|thought|suppose|guess|imagine|know|tell|ask|asking|say|see|find|figure|work|understand|clue|q|"
    "got|give|remember|make|out|quite|really|very|ever|so|much|most|super|pretty|terribly|awfully|extremely|truly|absolutely|"
    "just|also|grateful|glad|happy|pleased|delighted|thankful|obliged|appreciate|appreciated|curious|interested|kind|enough|"
    "nice|good|great|cool|awesome|lovely|sweet|fun|amazing|wonderful|fantastic|brilliant|perfect|best|better|idea|a|an|any|"
    "the|to|me|us|my|for|about|please|pardon|excuse|sorry|forgive|dear|hello|hi|hey|possible|possibly|way|chance|mind|moment|"
    "trouble|too|rather|maybe|perhaps|happen|now|ok|okay|well|um|uh|er|erm|hmm|oh|question|quick|wait|as|at|all|of|up|still|"
    "obliged|feasible|doable|conceivable|permissible|permitted|acceptable|able|request|requesting|trouble|troubling|bother|"
    "bothering|humbly|kindly|politely|feel|free|inclined|manage|arrange|willing|confirm|verify|establish|ascertain|specify|"
    "indicate|advise|might|must|hear|care|telling|tell|explain|explaining|show|showing|let|letting|inform|opinion|dare|allow|"
    "allowed|enquire|inquire|learn|discover|apologise|apologize|need|needs|required|desire|desired|ideal|ideally|solemnly|earnestly|sincerely|respectfully|formally|officially|cordially|urgently|[a-z]+[ai]ble"
)
WISHING = rf"(?:(?:{_WISHING_WORDS})(?:n?['’](?:d|m|s|ll|ve|re|t))?(?:[ ,]+|\.\.+ *))+"
"""How a wish or a question begins that says only that it is one: "I'd be ever so grateful", "wouldn't it be nice"."""
_ASKED_AFTER = re.compile(
    rf"^{WISHING}(?:(?=(?:if|whether|when|where|how|what|which|who|why)\b)"
    r"|(?=the (?:colou?r|size|speed|distance|number|position|length|duration|order)\b)"
    r"|(?<=[,:.;] )(?=(?:is|are|does|do|did|can|could|has|was|were)\b))"
)
_INTERJECTIONS = (
    r"(?:l+o+l+|(?:ha){2,}h?|(?:he){2,}|omg|wow+|whoa+|yay+|ugh+|meh+|h+m+|pff+t?|aw+|yo|phew|gosh|please|jeez|dang|damn|for "
    r"(?:heaven s|god s|pete s) sake|for the love of [a-z]+|btw|by the way|fyi|imo|imho|tbh|honestly|frankly|pretty please|to be "
    r"honest|in my opinion|if you ask me|anyhow|anyway|anyways|no rush|no hurry|possibly|kindly|gladly|basically|literally|ideally|"
    r"hopefully|obviously|definitely|certainly|seriously|surely|absolutely|essentially|preferably|magically|nothing (?!else|but|"
    r"more|less|except|other|only)(?:too |that |so )?[a-z]+(?=[ ]*(?:[,.;!]|$))|on second thoughts?|come to think of it|all things "
    r"considered|for what it is worth|to be fair|by all means|at your convenience|in fact|in truth|in short|if memory serves|"
    r"needless to say|as you know|as i said|as (?:discussed|agreed|usual|always|ever)|on reflection|upon reflection|having thought "
    r"about it|no offense|no offence|truth be told|no (?:biggie|big deal|cap)|on god|for real|all of them|every one of them|each "
    r"of them|both of them)"
)
"""Words that stand for themselves."""
_WISHED = word_set("like love want need wish prefer going way able me us how have try")
_NOT_WISHED = "".join(f"(?<!{word} )" for word in sorted(_WISHED))
_PLAIN = {
    # politeness
    "if": rf"(?:,\s*)?(?<!as )\b(?:if|provided|providing|assuming|supposing|in case|as long as)(?: that)? (?:that|this|it|you|"
    rf"possible|need be|i|we|there is|there are|not|any|at all|okay|allowed|one)\b(?: "
    rf"(?:{_POLITE_WORDS}|one|any|such|there|exists?|finds?|sees?|spot|anywhere))*{_UNTIL}",
    "when": rf"(?:,\s*)?\b(?:when|whenever|as soon as|once) (?:you|it) "
    rf"(?:get|have|can|could|like|find|is|are|feel|suits)\b(?: "
    rf"(?:{_POLITE_WORDS}|convenient|ready|free|suits|round|around))*{_UNTIL}",
    "while": r"(?:,\s*)?\bwhile (?:you are|we are|i am|being) (?:at it|there|on it|already there)\b,?",
    "thanks": (
        r"(?:,\s*|-\s*)?\b(?:please and )?(?:(?:many|much|so|big) )*(?:thanks|thank you|thx|ty|ta|cheers|tia|much appreciated|"
        r"appreciated?(?: it)?)\b(?: (?:a lot|so much|very much|in advance|a bunch|a ton|a million|you|for that|for (?:the|"
        r"your) help|again|much|ahead of time))*"
    ),
    "signed": r"[.,;!?-]\s*(?:(?:many|kind|kindest|best|warm|warmest|with|yours|very|all the|lots of) )*(?:thanks|thank you|"
    r"regards|wishes|cheers|yours|truly|sincerely|faithfully|love|best|x+|greetings|hugs)(?: again| in advance| a lot| so much| "
    r"truly| sincerely)*\s*[,.!-]*\s*(?:[a-z]+ )?(?:[a-z]+)?\s*[.!]*\s*$",
    "interjection": rf",\s*\b{_INTERJECTIONS}(?=\s*(?:[,.;:!?]|$))|\b{_INTERJECTIONS}\b(?:\s*,)?",
    "comment": (
        rf"[,.;] *(?:can|could|would|will) you (?:do|manage|handle|try) (?:it|that|this)(?: for me)?(?=[ ?.!]*$)|"
        rf"(?:,|\.|;|-)\s*(?:(?:i|we) (?:think|guess|suppose|believe|reckon|hope|bet|feel)\s*)?(?:that|this|it|which|would|"
        rf"should)(?: (?:would|will|should|might|could|must|is|be|looks?|going to))*(?: (?:so|really|very|super|much|just|"
        rf"way))* (?:{_NICE})(?: (?:i think|for me|like that|that way))?{_UNTIL}"
    ),
    "tag": (
        r",\s*(?:is|are|was|were|does|do|did|can|could|would|should|will|has|have)(?: not)? (?:it|they|he|she|you|we|"
        r"i)\b(?=\s*(?:[,.?!;]|$))|(?:[,.?!]\s*)(?:okay|right|yeah|yes|will you|would you|could you|can you|do you mind|is that "
        r"okay|what do you think|got it|deal|agreed|how|how come|any (?:ideas?|tips|help|suggestions?)(?: appreciated| welcome)?|"
        r"you know|you see|i think|i guess|i suppose|i reckon|i would say|or what)\s*(?=[?.!]*\s*$)"
    ),
    "or so": (
        r"\bor (?:so|something|whatever|thereabouts|similar|anything)\b(?: (?:like that|similar|of that kind|along those lines))?"
    ),
    "apology": r"^\s*(?:(?:i|we) )?(?:(?:do|must|really|humbly|am|very|so|terribly) )*(?:apologi[sz]e|beg (?:your |you )?pardon|"
    r"sorry|excuse me|pardon(?: me)?|forgive me|my bad|oops)\b(?: (?:for|to|about|that) [^,.;]*?)?\s*[,.;:!-]+\s*(?:but\b,?)?",
    "as said": r"(?:,\s*)?\b(?:like|as) (?:i|we|you) (?:said|told you|mentioned|asked|discussed|agreed|know|see|can see)(?: "
    "before| earlier|"
    r" already| above)?\b\s*,?",
    "said": r"(?:^|[,.;])\s*(?:(?:but|so|and|now|yes|okay)\b,?\s*)?(?:i|we) (?:know (?:i|we) )?(?:said|wrote|typed|"
    r"asked for|told you)\b [\w # ]{1,40}?,? but\b,?(?: now\b)?",
    "vocative": rf"^\s*{_CALLED}\s*[,!]\s*|(?:,\s*{_CALLED})+\s*(?=[?.!]*\s*$)",
    "source": r"(?:,\s*)?\b(?:according to|as per|per|in line with|in keeping with|in accordance with|following) (?:the|my|our|"
    "your|their) "
    r"(?:\w+ )?(?:brief|client|script|storyboard|plan|notes?|request|boss|director|instructions?|guidelines?|guide|feedback|spec|"
    r"specs|email|order|rules?|book|wishes)\b(?: s \w+)?\s*,?",
    "other time": rf"(?:,\s*)?\b(?:rather than|instead of|as opposed to) (?:in|at|by|on|during) [a-z ]{{1,30}}?{_UNTIL}",
    "no": r"^\s*(?:no\b[ ,.!]*)+(?=(?:not|do not|i|leave)\b)",
    "hurry": r"^\s*(?:hurry(?: up)?|come on|go on|quick|now then|right then|chop chop|look lively)\b\s*(?:[,.!]|"
    r"and\b)\s*(?:and\b)?",
    "salutation": r"^\s*(?:dear|hi|hello|hey|hiya|good (?:morning|afternoon|evening|day))(?: [a-z]+){1,2}? , ",
    "opening": rf"^\s*(?:{_OPENING}(?:\s*[,.!:;-]+|(?=\s+(?:now|then|so|let|can|could|please|next|i|we|{_OPENING})\b))\s*)+"
    r"(?:(?:and|so|now|then|next)\b\s*[,:]?\s*)*",
    "ordering": r"^\s*(?:(?:and|oh|okay|ok|right|so|well|sorry)\b\s*,?\s*)*(?:(?:(?:one|the|a|and) )?(?:more|last|final|other|next|"
    r"first|another) (?:thing|request|point|item|wish)|last but not least|to (?:finish|start|begin|end)(?: off| up| with)?|for "
    r"(?:a start|starters)|first off|first of all|quick one|(?:quick|small|little|tiny|minor) (?:thing|fix|job|"
    r"favou?r|tweak|request)|after that|and then|plus|next(?: up| thing)?|finally|also)\b(?:\s*[,:])?",
    # reasons
    "since": r"^\s*(?:since|because|seeing (?:that|as)|given that)\b [^,]*,",
    "because": r"(?:,\s*)?\b(?:because|cause|cuz|coz|cos)\b(?: of)? [^.;!?]*|(?:,\s*)?\b(?:since|as) (?:i|we|you|my) [^.;!?]*",
    "so": r"(?:,\s*)?\bso (?:that )?(?:i|we|you|people|everyone|everybody|nobody|no one|anyone|one|(?:my|our|your|the|every|no) "
    r"\w+|[a-z]+s(?= (?:can|could|will|feel|see|know|get|notice))) [^.;!?,]*|(?:,\s*)?\bin order to [^.;!?,]*",
    "seen": r"(?<!it)(?:,)?\s*\bso (?:that )?(?:i|we|you|one|people|everyone|everybody|anyone) (?:(?:can|could|will|may|would) )?"
    r"(?:(?:still|better|clearly|actually|also) )*(?:see|notice|spot|look at|make out|recogni[sz]e)s? (?!through|only|just|nothing)"
    r"[^.;!?,]*",
    "to": r"^\s*(?:and |so )?to (?!the\b|my\b|an?\b|me\b|us\b|its?\b)[a-z]+ [^,.;]*,",
    "match": rf"(?:,\s*)?\b{_NOT_WISHED}(?:so as |in order )?to (?:match|fit|suit|go with|draw|catch|attract|emphasi[sz]e|"
    "highlight|"
    r"convey|suggest|indicate|impress|please|avoid|prevent|surprise|amuse|celebrate|honou?r|test|check|see (?:if|whether)) "
    r"[^,.;!?]*",
    "for": r"(?:,\s*)?\bfor (?:[a-z]+ ){1,4}(?:reasons?|purposes?|sake|looks?|feel|feeling|effect|mood|vibes?|atmosphere|"
    r"impression|drama|clarity|kicks)\b|(?:,\s*)?\b(?:just )?for (?:kicks|laughs|giggles|sport|show)\b|"
    r"(?:,\s*)?\bfor (?:my|our) [^.;!?,]*|(?:,\s*)?\bfor (?:fun|a laugh|effect|a change|the fun of it|dramatic "
    r"effect|clarity|emphasis|my taste|my liking|my eyes|starters|example|instance)\b",
}
"""Class -> what is dropped, on the words of a sentence with blanks between."""
_LIKE = (
    r"(?:,\s*)?\b(?:just |exactly |a bit |kind of )?like (?:in |on |at |from )?(?:a|an|the|some|those|that|these|my|your|"
    r"our|they|you|we|when|magic|crazy|mad|hell|anything|never before|fresh|ripe|in|on|from)\b[^,.;!?]*|"
    r"(?:,\s*)?\bas (?:if|though) (?:i|we|you|someone|somebody|nobody|they|nothing|by|it (?:had|has|never|was never))\b[^,.;!?]*|"
    r"(?:,\s*)?\b(?:like|as|the way) (?:it|he|she|they) (?:is|are|was|were|does|do|did|always|usually|often|normally)(?: (?:is|are|"
    r"was|were|does|do|did|looks?|always|usually|often))? (?:in|on|at|when|during|for|back|every|with|after|before)\b[^,.;!?]*"
)
_LIKENED = word_set(
    "look looks looking seem seems feel feels sound act move run walk dance be is are something more should would i we you "
    "they do to not"
)
"""Words behind which "like" says what is wished for."""
_MOST_COMPARED = 5
"""Words of "like an ant", which is no ant of the scene."""
_REPORTED = (
    r"^\s*(?:(?:my|our|the|a) (?:[a-z]+ )?(?P<who>[a-z]+) (?:really |just |also )?(?:needs?|wants?|likes)\b|(?:(?:my|"
    r"our|the|a) (?:[a-z]+ )?)?(?P<speaker>(?!would\b|might\b)[a-z]+) (?:really |just |also )?(?:wants|wanted|asked|"
    r"asks|would like|prefers?|says|said|thinks|thought|requested|requests|insists|insisted|suggested|suggests|loves|"
    r"begs|demands|reckons|feels|hopes|(?:would|might) (?:really |rather |much )?(?:like|love|prefer|want|appreciate|"
    r"enjoy))\b)(?: me| us| you)?(?: for| on| that| to (?:see|have|get))?"
)
"""A wish of somebody else: "my boss wants"."""
_GOES_ON = re.compile(r"(?:,|\band\b|\bthen\b|\bbut\b)\s*(?:then |also |please |the )*([a-z]+)")
_NUMBERS = re.compile(r"\d")
PURPOSES = frozenset({"so", "for", "to", "match"})
"""Classes that may say what is meant to become of a thing."""
_COURTESIES = ("signed", "opening", "ordering", "if", "thanks", "interjection", "apology", "vocative", "hurry")
"""Classes that questions have, too."""
_CLAUSES = PURPOSES | {"because", "seen"}


def without_asides(
    sentence: str, known: Mapping[tuple[str, ...], str], verbs: frozenset[str], is_look: Callable[[str], bool]
) -> tuple[str, frozenset[str]]:
    """The sentence without what adds nothing, and the classes of what was left out.

    `verbs`: those of commands, which end a reason; `is_look`: whether a word is what something can look like.
    """
    tokens = tokenise(sentence)
    things = {words[-1] for words in known}
    text, starts = _plain_text(tokens)
    gone: dict[int, str] = {}

    def leave_out(kind: str, begin: int, end: int) -> None:
        gone.update({i: kind for i, start in enumerate(starts) if begin <= start < end and i not in gone})

    for kind, pattern in _PLAIN.items():
        for found in re.finditer(pattern, text):
            if kind in _CLAUSES:
                own = [verb for verb in _GOES_ON.findall(found.group()) if verb in verbs]
                if (
                    own
                    or not found.group().strip(" ,")
                    or (kind not in ("because", "seen") and things & set(found.group().split()))
                ):
                    continue
            if kind == "signed" and not (verbs | things).isdisjoint(found.group().split()):
                continue
            leave_out(kind, found.start(), found.end())
    for found in re.finditer(_LIKE, text):
        words = found.group().replace(",", " ").split()
        compared = words[1:2] and words[1] in ("a", "an") and len(words) < _MOST_COMPARED
        named = things & {form for word in words for form in (word, singular(word))}
        supposed = words[:2] in (["as", "if"], ["as", "though"])
        plain = (compared or supposed or not named) and not any(map(is_look, words))
        goes_on = any(verb in verbs for verb in _GOES_ON.findall(found.group().lstrip(" ,")))
        before = text[: found.start()].split()[-2:]
        likened = {*before[-1:]} & _LIKENED or before[:-1] == ["as"]  # "as big as it was before" says how big
        if plain and not likened and not goes_on and not _NUMBERS.search(found.group()):
            leave_out("like", found.start(), found.end())
    reported = re.match(_REPORTED, text)
    who = reported and (reported["who"] or reported["speaker"])
    if reported and who and not {who, singular(who)} & (things | VOCABULARY | FUNCTION_WORDS):
        leave_out("name", 0, reported.end())
    if not gone:
        return sentence, frozenset()
    kinds = frozenset(gone.values())
    left = cut(sentence, [(token.start, token.end) for i, token in enumerate(tokens) if i in gone])
    return left.rstrip("? ") if "tag" in kinds else left, kinds


def without_courtesy(question: str) -> str:
    """The question without courtesies that stand apart: "if you don't mind, where is the dog?"."""
    question = _ASKED_AFTER.sub("", question)
    tokens = tokenise(question)
    text, starts = _plain_text(tokens)
    places = [found.span() for kind in _COURTESIES for found in re.finditer(_PLAIN[kind], text)]
    spans = [(t.start, t.end) for t, at in zip(tokens, starts, strict=True) if any(a <= at < b for a, b in places)]
    return cut(question, spans) if spans else question


def _plain_text(tokens: list[Token]) -> tuple[str, list[int]]:
    """The words with blanks between, and where each begins."""
    starts, text = [], ""
    for token in tokens:
        starts.append(len(text))
        text += token.text + " "
    return text, starts


def cut(sentence: str, spans: list[tuple[int, int]]) -> str:
    """The sentence without the characters of `spans`, in order, and without the commas that then stand at its ends."""
    kept, at = "", 0
    for start, end in spans:
        kept, at = kept + sentence[at:start] + " ", max(end, at)
    kept = " ".join((kept + sentence[at:]).split())
    return re.sub(r"\s+([,.;!?])", r"\1", re.sub(r"^[\s,;.:!?-]+|[\s,;:-]+$", "", kept))
