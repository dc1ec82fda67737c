"""What is wrong is told in the same words by whichever process finds it."""

from __future__ import annotations

import pickle

import pytest

from calibration.errors import InputError, Problem
from pipeline.storage import MissingError


@pytest.mark.parametrize("kind", [InputError, MissingError])
def test_an_error_told_by_another_process_says_the_same(kind):
    wrong = [Problem("is not a raw file", "DNG", "take it out", "a.dng"), Problem("b", "", "c")]
    error = kind(wrong)
    told = pickle.loads(pickle.dumps(error))
    assert type(told) is kind
    assert told.problems == error.problems
    assert str(told) == str(error)
