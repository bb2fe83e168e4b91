"""People in the sidebar: a click means the person, with Ctrl the limb; words, sentences and remarks are those of the core."""

import numpy as np
from people_scene import people_scene

from f4x_core.scene import write_scene
from f4x_core.scene.people import PARTS, people_of

from .artist import opened_at, perform

FRAME = 5
SCRIPT = f"""{opened_at(FRAME)}
def keep(name):
    arrays[name] = scene_object().read(".selection")
    noted[name] = [root().f4x.found, root().f4x.answer]
at = tuple(json.loads(sys.argv[3]))
ops.query_point(frame={FRAME}, at=at); keep("click")
ops.query_point(frame={FRAME}, at=at, part=True); keep("part")
for words in ("second person", "woman", "person on the left", "dancer's left hand"):
    ops.query_text(text=words); keep(words)
ops.query_text(text="person 2"); ops.plan(sentence="select the other man"); keep("other")
ops.plan(sentence="make the second woman red"); keep("red")
noted["absent"] = refused(ops.plan, sentence="hide the third person")
"""


def test_a_click_means_the_person_and_words_come_with_what_the_scene_cannot_tell(tmp_path):
    """At the last frame the first person has walked past the second one: who is on the left is asked of that frame."""
    scene = people_scene(2, pace=0.13)
    write_scene(scene, tmp_path / "scene.f4x")
    people, part = people_of(scene), PARTS.index("left hand") + 1
    hand = (people.person == 2) & (people.part == part)
    pixel = scene.cameras[FRAME].project(scene.posed(FRAME).means[hand].mean(0)[None].astype(float))[0][0]
    noted, arrays = perform(tmp_path, SCRIPT, pixel.tolist())
    chosen = {
        "click": people.person == 2,
        "part": hand,
        "second person": people.person == 2,
        "woman": people.person > 0,
        "person on the left": people.person == 2,
        "dancer's left hand": people.part == part,
        "other": people.person == 1,
    }
    for name, rows in chosen.items():
        assert np.array_equal(arrays[name], rows), name
    assert "cannot tell men from women" in noted["woman"][0] and "counted from left" in noted["second person"][0]
    assert "cannot tell what people are or do" in noted["dancer's left hand"][0]
    assert "cannot tell men from women" in noted["red"][1] and "There are 2 people" in noted["absent"]
