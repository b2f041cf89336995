"""The list of mutants follows the sources: each text stands where a mistake would replace it."""

import pytest
from documents import ROOT
from mutant_list import MUTANTS, Mutant


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.file)
def test_a_mutant_changes_a_single_place_and_names_tests_that_exist(mutant: Mutant) -> None:
    assert (ROOT / mutant.file).read_text().count(mutant.old) == 1
    files = [word.partition("::")[0] for word in mutant.tests.split() if not word.startswith("-")]
    assert files and all((ROOT / "test" / file).is_file() for file in files)
