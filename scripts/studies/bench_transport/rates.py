# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays a second against bare rays, the warm transport of an estimate, light between surfaces, look-ups."""

import time
from collections import defaultdict
from contextlib import ExitStack, contextmanager
from unittest import mock

import numpy as np

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.render import radiosity
from btfsep_engine.render.appearance import LightTables
from btfsep_engine.render.arrays import dr, mi, vector
from btfsep_engine.render.tracer import OFFSET, Tracer
from btfsep_engine.render.transport import Transport
from btfsep_engine.render.weights import Weights
from btfsep_engine.storage import kept
from scripts.studies.measures import seconds_of, timed
from scripts.studies.stage import MATERIALS, Stage
from scripts.studies.tables import table

DIRECTIONS = 512
TRUE = 8192  # directions of the truth
READ = 22  # floats and integers that one evaluation gathers: grid, 9 of the weights, 3 corners, 3 x 3 values
STEPS = (  # of the transport, and where each is called; the innermost counts
    ("rays", Tracer, "visible_lanes"),
    ("light", Transport, "_lights"),
    ("pixels' tables", LightTables, "tables_at"),
    ("look-ups and weights", Weights, "of_all"),
)


def rays(options) -> str:
    """Rays a second inside the kernel against a bare loop of the same rays, called in turn."""
    stage, lights = Stage(), SHBasis(9)
    points, tracer = stage.sample(), stage.tracer
    material = open_library(None).load(MATERIALS[0])
    directions = stage.transport(points, DIRECTIONS).directions
    point, direction = np.nonzero(points.flat_normal @ directions.T > 0)
    start = tracer.to_local(points.position) + OFFSET * points.flat_normal
    origin, omega = mi.Point3f(vector(start[point])), vector(directions[direction])
    dr.eval(origin, omega)

    def bare():
        blocked = tracer.scene.ray_test(mi.Ray3f(origin, omega), coherent=False)
        dr.eval(blocked)
        dr.sync_thread()

    rows = []
    for label, used in (("mean ABRDF", material.mean_material()), (f"BTF {MATERIALS[0]}", material)):

        def kernel(used=used):
            return stage.transport(points, DIRECTIONS).radiance(used, lights)

        bare(), kernel()
        pairs = np.array([[timed(f, afresh=True)[0] for f in (bare, kernel)] for _ in range(options.pairs)])
        rate = np.median(len(point) / pairs / 1e6, 0)
        share = np.median(pairs[:, 0] / pairs[:, 1], 0)
        rows.append(
            (label, *(f"{rate[i, 0]:.1f} ({rate[i, 1]:.1f})" for i in (0, 1)), f"{share[0]:.0%} ({share[1]:.0%})")
        )
    head = ("rays of an estimate", "bare loop, million/s", "whole transport, million/s", "share")
    return (
        f"{len(points)} pixels, {DIRECTIONS} directions, order 9: {len(point) / 1e6:.2f} million rays above the "
        f"horizon; medians of {options.pairs} pairs, by the clock and (by processor time).\n\n" + table(head, rows)
    )


@contextmanager
def steps(dr):
    """Inside, the processor seconds of each of `STEPS` are added up in the dict that is given."""
    spent, running = defaultdict(float), []

    def watched(label, method):
        def call(*arguments, **named):
            dr.sync_thread()
            started = time.process_time()
            running.append(0.0)
            result = method(*arguments, **named)
            dr.sync_thread()
            whole = time.process_time() - started
            spent[label] += whole - running.pop()
            if running:
                running[-1] += whole
            return result

        return call

    with ExitStack() as stack:
        for label, cls, name in STEPS:
            stack.enter_context(mock.patch.object(cls, name, watched(label, getattr(cls, name))))
        yield spent


def warm(options) -> str:
    """The transport of an estimate when everything is compiled, whole and by step."""
    stage, lights = Stage(), SHBasis(9)
    points, material = stage.sample(), open_library(None).load(MATERIALS[0])
    albedo, rows, parts = [radiosity.diffuse_albedo(material)], [], []
    for label, used in (("mean ABRDF", material.mean_material()), (f"BTF {MATERIALS[0]}", material)):
        truth = stage.transport(points, TRUE).radiance(used, lights)
        for directions in (256, DIRECTIONS):

            def run(directions=directions, used=used):
                return stage.transport(points, directions).radiance(used, lights)

            seconds, got = seconds_of(run, options.repeats, afresh=True)
            rows.append(
                (
                    f"{label}, {directions} directions",
                    *_both(seconds),
                    f"{np.linalg.norm(got - truth) / np.linalg.norm(truth):.3f}",
                )
            )
            with steps(dr) as spent:
                whole = sum(timed(run, afresh=True)[0][1] for _ in range(options.repeats))
            named = [spent[name] for name, _, _ in STEPS]
            shown = [f"{1000 * s / options.repeats:.0f}" for s in (whole, *named, whole - sum(named))]
            parts.append((f"{label}, {directions}", *shown))

    def first():
        return radiosity.Indirect(stage.tracer, albedo, lights, bounces=3).reflected(some, material.mean_material())

    def again():  # in a scene whose geometry is known
        kept.STORE.forget()
        radiosity.network(stage.tracer, samples=radiosity.SAMPLES, seed=0)
        return timed(first)

    some = stage.transport(points, 128)
    known = np.median([again()[0] for _ in range(options.repeats)], 0)
    for label, (seconds, got) in (
        ("first in a scene", seconds_of(first, options.repeats, afresh=True)),
        ("geometry known", (known, again()[1])),
    ):
        share = np.linalg.norm(got) / np.linalg.norm(truth)
        rows.append((f"light between surfaces ({share:.1%} of the radiance), {label}", *_both(seconds), ""))
    return (
        f"{len(points)} pixels, order 9; medians of {options.repeats}; errors are relative L2 of the {lights.count} "
        f"basis images against {TRUE} directions.\n\n"
        + table(("warm transport", "s", "processor s", "error"), rows)
        + "\n\nMilliseconds of processor of its steps, each waited for:\n\n"
        + table(("", "whole", *(name for name, _, _ in STEPS), "products with the light, the rest"), parts)
    )


def _both(seconds):
    return f"{seconds[0]:.2f}", f"{seconds[1]:.2f}"


def between(options) -> str:
    """What the light between surfaces needs: samples of the surfaces, and directions of each sample and pixel."""
    stage, lights, white = Stage(textured=False), SHBasis(4), Lambertian("white", np.full(3, 0.8))
    points = stage.sample(1000)
    direct = np.linalg.norm(stage.transport(points, 512).radiance(white, lights))

    def run(samples, gathered, directions):
        with mock.patch.object(radiosity, "DIRECTIONS", gathered):
            indirect = radiosity.Indirect(stage.tracer, [white.albedo], lights, bounces=3, samples=samples)
            return timed(lambda: indirect.reflected(stage.transport(points, directions), white), afresh=True)

    truth, rows = run(*options.between_truth)[1], []
    for setting in ((3000, 256, 128), (3000, 64, 128), (6000, 64, 128), (1500, 64, 128), (3000, 64, 512)):
        seconds, got = run(*setting)
        rows.append((*setting, f"{np.linalg.norm(got - truth) / direct:.4f}", *_both(seconds)))
    return (
        f"Light between white surfaces, {np.linalg.norm(truth) / direct:.1%} of the direct light; errors, relative to "
        "the direct light, against {} samples, {} directions of each and {} of a pixel.\n\n".format(
            *options.between_truth
        )
        + table(("samples", "directions of each", "of a pixel", "error", "s", "processor s"), rows)
    )


def lookups(options) -> str:
    """Evaluations of the BTF a second, against the same count of bare Dr.Jit gathers."""
    stage = Stage()
    points = stage.sample()
    transport, n = stage.transport(points, DIRECTIONS), len(points) * DIRECTIONS
    everything, rng = dr.full(mi.Bool, True, n), np.random.default_rng(0)
    table_of = mi.Float(rng.random(len(points) * 453).astype(np.float32))
    place = mi.UInt32(rng.integers(0, len(points) * 453, n).astype(np.uint32))
    dr.eval(table_of, place)

    def gathers():
        dr.eval(dr.gather(mi.Float, table_of, place))
        dr.sync_thread()

    bare = seconds_of(gathers, 5, of=np.min)[0][0]
    rows, library = [("bare gathers, one float each", f"{n / bare / 1e6:.0f}", "")], open_library(None)
    for name in options.materials:
        material = library.load(name)
        for label, which in (("BTF", material), ("mean ABRDF", material.mean_material())):
            least, _ = seconds_of(lambda w=which: transport.weights(w).of_all(points, everything), 3, of=np.min)
            share = READ * bare / least[0]
            rows.append((f"{name}, {label}", f"{n / least[0] / 1e6:.1f}", f"{share:.0%}"))
    heads = ("", "million evaluations/s", "of bare gathers of the same count")
    return f"{len(points)} points x {DIRECTIONS} directions = {n / 1e6:.1f} million.\n\n" + table(heads, rows)
