"""The check of words finds what it shall, in every file that it shall."""

from pathlib import Path

import banned_words
import pytest

WORDS = {"tell": "report", "says": "states", "what there is": "its name", "is none": "has no"}


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("Sensors tell\nit.", [(1, "tell")]),
        ("one\nHe Says so, what\nthere is", [(2, "says"), (2, "what there is")]),
        ("retell, told_by, tell_all, essays", []),
        ("def test_what_there_is() -> None:", [(1, "what there is")]),
        ("see\n# what\n    # there is", [(2, "what there is")]),
        ("// what\n  // there is", [(1, "what there is")]),
        ("if x is None: there is nonesuch", []),
        ("this is\n    none", [(1, "is none")]),
    ],
)
def test_words_are_reported_with_their_line(text: str, result: list[tuple[int, str]]) -> None:
    assert [match[:2] for match in banned_words.find_banned(text, WORDS)] == result


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ('def f():\n    """What it is."""', [(2, "What")]),
        ('"""Where the tool is."""\n# Whoever asks', [(1, "Where"), (2, "Whoever")]),
        ("  // How far x is\n/* Which joint", [(1, "How"), (2, "Which")]),
        ('"""Whether it is closed."""\n# Where a joint sticks, M has a row less', []),
        ("x = 1  # What\n# However, Whole numbers", []),
        ("def test_a():\n    pass\n\n\ndef test_what_is_stuck_stays():", [(5, "test_what")]),
        ("def test_whatnots_are_wholes():", []),
    ],
)
def test_comments_begin_with_a_noun_or_a_verb(text: str, result: list[tuple[int, str]]) -> None:
    assert [match[:2] for match in banned_words.openings_in(text)] == result


def test_the_glossary_bans_and_each_page_is_checked() -> None:
    assert {"told", "said", "is none"} <= set(banned_words.banned())
    checked = {
        path.relative_to(banned_words.ROOT).as_posix()
        for path in banned_words.files(banned_words.ROOMS)
    }
    assert {"README.md", "docs/concepts/time.md", "arm_emulator/core/boundary/arm.h"} <= checked


def test_a_banned_word_ends_with_a_line_and_exit_code_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "page.md").write_text("fine\nwe told you\n")
    monkeypatch.setattr(banned_words, "ROOT", tmp_path)
    monkeypatch.setattr(banned_words, "ROOMS", ("page.md",))
    assert banned_words.main() == 1
    assert capsys.readouterr().out.startswith("page.md:2: 'told' is banned; write report")


def test_released_entries_of_the_change_log_are_not_checked() -> None:
    text = banned_words.text_of(banned_words.ROOT / "CHANGELOG.md")
    assert text.count("\n## ") == 1 and "[Unreleased]" in text


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("def test_the_servo_is_reported_what_voltage_was_applied() -> None:", True),
        ("a servo that is reported eq. (6)", True),
        ("def test_a_full_disk_is_reported() -> None:", False),
        ("The step that is reported is that of the start.", False),
    ],
)
def test_a_receiver_is_not_reported_a_fact(text: str, result: bool) -> None:
    assert bool([*banned_words.find_banned(text, banned_words.banned())]) == result
