"""The notation of phrases: words and names of rules, in brackets where one of several, or perhaps none, stands there."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import reduce
from operator import add
from typing import Any

from .grammar import NAMES_TOO, Rule, either, optional, silent, split, table, unless
from .lexicon import every_form
from .verbs import any_form, asked_form

_MORE_THAN_WORDS = re.compile(r"[<!]|^\([^()]*\)$")
"""In an alternative that names rules or may be empty."""
_FORMS: dict[str, Callable[[str], str]] = {"=": every_form, "!": asked_form}


class Notation:
    """Makes rules of phrases that name rules of one module: "by|(about) <number> [unit|units]".

    `a|b`: one of them; `[a|b]`: one of them; `(a|b)`: one or none; `<number>`: a rule, `<number?>`: its value or None, `<.number>`:
    without its value; `!a`: not where a stands; `{blur}`: the verbs of a sense in all forms, `{=sit}`: the forms of a verb,
    `{!take}`: those that ask for it.
    """

    def __init__(self, names: Mapping[str, Any], vocabulary: set[str] = NAMES_TOO):
        """Write rules with the rules in `names`; `vocabulary` receives the words, as in `table`."""
        self.names, self.vocabulary = names, vocabulary

    def __call__(self, spec: str | Rule, **rules: Rule) -> Rule:
        """Return the rule of a phrase, with the values of the rules that it names, `rules` before those of the module."""
        if isinstance(spec, Rule):
            return spec
        ways = split(re.sub(r"\{([=!]?)([^}]*)\}", _verbs, spec))
        plain = [one for one in ways if not _MORE_THAN_WORDS.search(one)]
        made = [self._words("|".join(plain))] if plain else []
        made += [self._sequence(one, rules) for one in ways if one not in plain]
        return made[0] if len(made) == 1 else either(*made)

    def table(self, meanings: Mapping[str, Any], **rules: Rule) -> Rule:
        """Return the rule of phrases, earlier ones preferred, each with its value or a function of the values that it names."""
        return either(
            *(
                self(spec, **rules) >> (meaning if callable(meaning) else lambda *_, meaning=meaning: meaning)
                for spec, meaning in meanings.items()
            )
        )

    def _words(self, spec: str) -> Rule:
        return table({spec: None}, vocabulary=self.vocabulary)

    def _sequence(self, spec: str, rules: Mapping[str, Rule]) -> Rule:
        """Return the rule of parts with spaces between."""
        steps: list[Rule] = []
        words: list[str] = []
        for part in [*filter(None, split(spec, " ")), ""]:
            if part and part[0] not in "<!" and "<" not in part and (part[0] != "(" or words):
                words.append(part)
                continue
            if words:
                steps.append(self._words(" ".join(words)))
                words = []
            if part:
                steps.append(self._part(part, rules))
        return reduce(add, steps)

    def _part(self, part: str, rules: Mapping[str, Rule]) -> Rule:
        if part[0] == "!":
            return unless(self._part(part[1:], rules) if part[1] in "<([" else self(part[1:], **rules))
        if part[0] == "(":
            return ~self(part[1:-1], **rules)
        if part[0] == "[":
            return self(part[1:-1], **rules)
        name = part[1:-1].strip(".?")
        rule: Rule = rules[name] if name in rules else self.names[name]
        return silent(rule) if part[1] == "." else optional(rule) if part[-2] == "?" else rule


def _verbs(found: re.Match[str]) -> str:
    kind, verbs = found[1], found[2]
    return _FORMS[kind](verbs.replace("/", "|")) if kind else any_form(*verbs.split(","))
