# SPDX-License-Identifier: GPL-3.0-or-later
"""A kept recogniser is that of the very code, constants and version that would train it now."""

import re
import shutil
import threading

import numpy as np
import pytest

from btfsep_engine.recognise import descriptors, model_file, training
from btfsep_engine.recognise.vlad import Encoding
from btfsep_engine.storage import cache
from btfsep_engine.storage.kept import STORE

CONSTANTS = {
    "recognise/training.py": ("NOISES", "BLURS", "SAMPLE", "METHODS"),
    "recognise/classifier.py": ("C_GRID", "GAMMA_GRID", "FOLDS", "KNOWN_SHARE"),
    "recognise/descriptors.py": ("TAPS", "FALLBACK_BINS", "GREY"),
    "recognise/vlad.py": ("COLOUR_WORDS", "SIFT_WORDS"),
    "pipeline/recognition.py": ("WINDOW", "INDISTINGUISHABLE"),
    "render/tracer.py": ("OFFSET",),
}


@pytest.fixture(scope="module")
def engine(tmp_path_factory):
    """A copy of the engine's own code."""
    folder = tmp_path_factory.mktemp("copy") / "engine"
    return shutil.copytree(model_file.ENGINE, folder, ignore=shutil.ignore_patterns("data", "__pycache__"))


def digest(folder):
    return model_file.source_digest.__wrapped__(folder)


@pytest.mark.parametrize(("file", "name"), [(f, n) for f, names in CONSTANTS.items() for n in names])
def test_a_changed_constant_is_another_key(engine, file, name):
    before, text = digest(engine), (engine / file).read_text()
    changed, times = re.subn(rf"^({name} = .*?)([^\s)}}]+)", r"\g<1>1 + \2", text, count=1, flags=re.M)
    assert times == 1
    (engine / file).write_text(changed)
    try:
        assert digest(engine) != before
    finally:
        (engine / file).write_text(text)
    assert digest(engine) == before


def test_the_key_is_of_the_code_that_runs_and_of_its_version(engine, monkeypatch):
    before = digest(engine)
    assert digest(model_file.ENGINE) == before
    monkeypatch.setattr(model_file, "__version__", "99")
    assert digest(engine) != before


def test_other_code_trains_again(tmp_path, monkeypatch, rng):
    mask = np.ones((64, 64), bool)
    images = [training.TrainingImage(m, "one", rng.random((64, 64, 3)) + 1, mask) for m in ("a/a", "b/b")]
    method = training.Method(descriptors.Settings(target=50), Encoding(colour_words=4, sift_words=4))
    recogniser, trained = training.train(images, method=method), []

    def ask():
        STORE.forget()  # as in a process that has just begun
        model_file.cached("key", lambda: trained.append(1) or recogniser, folder=tmp_path)
        return len(trained)

    assert [ask(), ask()] == [1, 1]
    monkeypatch.setattr(model_file, "source_digest", lambda: "of other code")
    assert [ask(), ask()] == [2, 2]
    entry = max((tmp_path / "recognisers").iterdir(), key=lambda p: p.stat().st_mtime_ns)
    good = cache.read(entry)
    bad = [good | {name: a * np.nan} for name, a in good.items() if a.dtype.kind == "f"]
    bad += [good | {"header": np.array(text)} for text in ("", "[]", "{}", "7", "hello")]
    bad += [{n: a for n, a in good.items() if n != name} for name in good] + [good | {"model.vectors": np.zeros(3)}]
    for number, arrays in enumerate(bad, 3):
        cache.write(entry, arrays)
        assert [ask(), ask()] == [number, number]


def test_of_two_who_need_the_same_training_one_trains(tmp_path):
    """The second begins while the first trains: it waits, and reads what was trained."""
    rng, mask = np.random.default_rng(0), np.ones((64, 64), bool)
    images = [training.TrainingImage(m, "one", rng.random((64, 64, 3)) + 1, mask) for m in ("a/a", "b/b")]
    method = training.Method(descriptors.Settings(target=50), Encoding(colour_words=4, sift_words=4))
    recogniser, begun, trained = training.train(images, method=method), threading.Event(), []

    def make():
        trained.append(1)
        begun.set()
        threading.Event().wait(0.5)  # in which the other asks
        return recogniser

    first = threading.Thread(target=model_file.cached, args=("key", make), kwargs={"folder": tmp_path})
    first.start()
    assert begun.wait(60)
    found = model_file.cached("key", make, folder=tmp_path)
    first.join()
    assert trained == [1] and found.materials == recogniser.materials


def test_a_training_that_cannot_be_locked_is_done_all_the_same(tmp_path):
    (tmp_path / "locks").write_text("in the way")
    with pytest.raises(ZeroDivisionError):
        model_file.cached("key", lambda: 1 / 0, folder=tmp_path)
