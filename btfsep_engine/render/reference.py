# SPDX-License-Identifier: GPL-3.0-or-later
"""The reference transport: the paper's own pipeline, one path-traced image for each light.

Mitsuba's path tracer renders the job's objects with the BSDF plugin ``btf`` under environment emitters; a basis light
that goes negative is rendered as its positive and its negative part. It shares with the kernel the material's tables
and the charts on the surfaces, and nothing of how the integral of eq. 1 is found: paths are independent, sampled by
the BTF and by the light, and follow interreflections with the full BTF. It is unbiased and slow.
"""

import time
from dataclasses import dataclass

import numpy as np

from btfsep_engine.btf.model import Lambertian, Material
from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.job.model import Job, Occluder
from btfsep_engine.progress import Reporter
from btfsep_engine.render.arrays import dr, mi, vector
from btfsep_engine.render.homogeneous import homogeneous, pictured
from btfsep_engine.render.mitsuba_bsdf import material_key
from btfsep_engine.render.parametrise import physical_uv
from btfsep_engine.render.radiosity import diffuse_albedo
from btfsep_engine.render.tracer import Tracer

LANES = 1 << 20  # paths traced at once
SKY_ROWS = 512  # of the emitters' maps: bilinear between them, order 9 is right to 0.05 %
CENTRE = (0.501, 0.5007)  # of a pixel: through the very centre, rays can meet an edge of a mesh and slip through it
BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}


@dataclass(frozen=True)
class ReferenceRadiance:
    """p pixels under M lights.

    Attributes
    ----------
    radiance : (p, M, 3) float32
    variance : (p, M, 3) float32, of ``radiance``, from the spread of the independent paths
    seconds : (M,) float64, wall-clock seconds for each light
    """

    radiance: np.ndarray
    variance: np.ndarray
    seconds: np.ndarray


def _occluder_material(occluder: Occluder, grey: float, millimetres_per_unit: float) -> Material:
    surface = occluder.surface
    if surface is None:
        return Lambertian("grey", np.full(3, grey))
    if surface.image is not None:
        return pictured(surface, GIVEN, occluder.mesh, millimetres_per_unit=millimetres_per_unit)
    return homogeneous(surface, GIVEN)


class Reference:
    """A job as a Mitsuba scene.

    Parameters
    ----------
    job : Job
    tracer : Tracer of the job's meshes, in the order of `PreparedScene`; gives the scale of the scene
    materials : one Material for each object, None: black. Unseen sides of depths are matte
    grey : what occluders of which the job does not say it reflect, matte
    bounces : reflections followed; 1 is light that comes straight from outside
    textured : true: texels and tangents by the objects' charts (`surface.with_texture`); false: only of materials that
        line up; for the others, of one texel, tangents follow the world's vertical (`surface.with_any_tangent`)
    reporter : told about charts
    """

    def __init__(
        self,
        job: Job,
        tracer: Tracer,
        materials,
        *,
        bounces: int = 1,
        textured: bool = True,
        grey: float = 0.0,
        reporter=None,
    ):
        self.job, self.tracer = job, tracer
        unseen = [
            m if m is None else Lambertian("unseen", diffuse_albedo(m))
            for m, o in zip(materials, job.objects, strict=True)
            if o.unseen is not None
        ]
        beside = [_occluder_material(o, grey, 1000 * job.metres_per_unit) for o in job.occluders]
        ways = [*(o.uv for o in job.objects), *["mesh"] * len(beside)]
        materials = [*materials, *beside, *unseen]
        self._shapes = {}
        for number, (mesh, material) in enumerate(zip(tracer.meshes, materials, strict=True)):
            laid = material is not None and (material.lines_up or (textured and number < len(job.objects)))
            uv = None
            if laid:
                uv = physical_uv(mesh, ways[number], millimetres_per_unit=1000 * job.metres_per_unit, reporter=reporter)
            self._shapes[f"shape{number:04d}"] = self._shape(number, mesh, self._bsdf(material, laid), uv)
        depth = {"max_depth": bounces + 1, "rr_depth": bounces + 2, "hide_emitters": True}
        self.integrator = mi.load_dict({"type": "path", **depth})

    def _bsdf(self, material: Material | None, textured: bool) -> dict:
        if material is None:
            return BLACK
        if material.matte_albedo is not None:
            albedo = {"type": "rgb", "value": material.matte_albedo.tolist()}
            return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": albedo}}
        if material.mirror_reflectance is not None:
            colour = {"type": "rgb", "value": material.mirror_reflectance.tolist()}
            conductor = {"type": "conductor", "material": "none", "specular_reflectance": colour}
            return {"type": "twosided", "bsdf": conductor}
        return {"type": "btf", "material": material_key(material.table), "tangents": "uv" if textured else "vertical"}

    def _shape(self, number, mesh, bsdf, uv):
        """A mesh whose corners are vertices of their own: normals and charts may break at every edge."""
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(bsdf)
        n = len(mesh.faces)
        shape = mi.Mesh(
            f"shape{number:04d}", 3 * n, n, properties, has_vertex_normals=True, has_vertex_texcoords=uv is not None
        )
        params = mi.traverse(shape)
        corners = self.tracer.to_local(mesh.vertices)[mesh.faces].astype(np.float32)
        params["vertex_positions"] = mi.Float(corners.ravel())
        params["vertex_normals"] = mi.Float(np.ascontiguousarray(mesh.corner_normals, np.float32).ravel())
        if uv is not None:
            params["vertex_texcoords"] = mi.Float(np.ascontiguousarray(uv, np.float32).ravel())
        params["faces"] = mi.UInt32(np.arange(3 * n, dtype=np.uint32))
        params.update()
        return shape

    def radiance(
        self, pixels, lightings, *, samples: int, seed: int = 0, jitter: bool = True, reporter: Reporter | None = None
    ) -> ReferenceRadiance:
        """Path-traces ``pixels`` once for each light (and each sign that it has).

        Parameters
        ----------
        pixels : (p, 2) int, row and column
        lightings : light.lightings.Lightings, M lights
        samples : paths for each pixel and sign
        seed : >= 0, of the random numbers; others give independent results
        jitter : true: paths start all over the pixel; false: through its centre, as the kernel's ray does
        reporter : told the progress of stage "transport"
        """
        pixels = np.asarray(pixels)
        shape = (len(pixels), lightings.count, 3)
        mean, variance = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        seconds = np.zeros(lightings.count)
        if lightings.count == 0 or not len(pixels):
            return ReferenceRadiance(mean, variance, seconds)
        started = time.perf_counter()
        render = 0
        for number, sign, scene in self._lit_scenes(lightings):
            # numbers of the independent sampler differ with the render: the parts' errors are independent
            got, spread = self._traced(scene, pixels, samples, (seed, render), jitter)
            mean[:, number] += sign * got
            variance[:, number] += spread
            render += 1
            seconds[number] += time.perf_counter() - started
            started = time.perf_counter()
            if reporter is not None:
                reporter.progress("transport", (number + 1) / lightings.count, lightings.names[number])
        return ReferenceRadiance(mean, variance, seconds)

    def _lit_scenes(self, lightings):
        """(number of the light, sign, scene) of everything that has to be rendered."""
        sky = self._skies(lightings)
        blank = mi.Bitmap(np.ones((SKY_ROWS, 2 * SKY_ROWS, 3), np.float32))
        # Mitsuba's maps have +Y up: its (x, y, z) is our (y, z, x)
        turn = mi.ScalarTransform4f(np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]))
        emitter = {"type": "envmap", "bitmap": blank, "to_world": turn}
        scene = mi.load_dict({"type": "scene", "light": emitter, **self._shapes})
        params = mi.traverse(scene)
        for number in range(lightings.count):
            for sign in (1, -1):
                part = np.maximum(sign * sky[number], 0)
                if not part.any():
                    continue
                closed = np.empty((SKY_ROWS, 2 * SKY_ROWS + 1, 3), np.float32)
                closed[:, :-1] = part
                closed[:, -1] = closed[:, 0]  # a last column that repeats the first closes the circle
                params["light.data"] = mi.TensorXf(closed)
                params.update()
                yield number, sign, scene

    @staticmethod
    def _skies(lightings) -> np.ndarray:
        """The lights on the emitter's grid: (M, SKY_ROWS, 2 SKY_ROWS, 3 or 1) float32.

        Mitsuba's rows reach from pole to pole, its columns are between (i, i + 1) / columns; both are interpolated.
        """
        polar = np.arange(SKY_ROWS) * (np.pi / (SKY_ROWS - 1))
        turn = (np.arange(2 * SKY_ROWS) + 0.5) * (np.pi / SKY_ROWS)
        out = None
        for row, theta in enumerate(polar):
            s = np.sin(theta)
            directions = np.stack(
                [-s * np.cos(turn), s * np.sin(turn), np.full_like(turn, np.cos(theta))], -1
            )  # Mitsuba's (sin, cos, -cos) of its own axes, in ours
            values = lightings.radiance(directions)
            if out is None:
                turns, lights, channels = values.shape
                out = np.empty((lights, SKY_ROWS, turns, channels), np.float32)
            out[:, row] = np.swapaxes(values, 0, 1)
        return out

    def _traced(self, scene, pixels, samples, seed, jitter):
        """Mean of the paths through each pixel and the variance of that mean: 2 x (p, 3) float32."""
        camera, (row, column) = self.job.camera, pixels.T
        axis = -camera.to_world[:3, 2]
        # origin and direction at the pixels' corners: within a pixel they are linear, a lens bends nothing so small
        corner, *ends = (
            np.stack([self.tracer.to_local(origins), directions / (directions @ axis)[:, None]])
            for origins, directions in (camera.rays(column + i, row + j) for i, j in ((0, 0), (1, 0), (0, 1)))
        )
        linear = [corner, *(end - corner for end in ends)]
        sampler = mi.load_dict({"type": "independent"})
        mean, variance = np.empty((2, len(pixels), 3), np.float32)
        step = max(1, LANES // samples)
        for start in range(0, len(pixels), step):
            part = slice(start, start + step)
            lanes = len(pixels[part]) * samples
            sampler.seed(int(np.random.SeedSequence([*seed, start]).generate_state(1)[0]), lanes)
            point = dr.arange(mi.UInt32, lanes) // dr.opaque(mi.UInt32, samples)
            within = sampler.next_2d() if jitter else mi.Point2f(*(dr.opaque(mi.Float, x) for x in CENTRE))
            origin, direction = (
                at + within.x * right + within.y * down
                for at, right, down in (
                    [dr.gather(mi.Vector3f, vector(a[k, part]), point) for a in linear] for k in (0, 1)
                )
            )
            ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(origin), dr.normalize(direction)))
            colour, _, _ = self.integrator.sample(scene, sampler, ray)
            dr.eval(colour)  # now: every sum would trace the paths again
            sums = []
            for channel in (colour.x, colour.y, colour.z):
                value = mi.Float64(channel)
                sums += [dr.block_sum(value, samples), dr.block_sum(value * value, samples)]
            dr.eval(sums)
            total, squares = np.array([np.array(a) for a in sums]).reshape(3, 2, -1).transpose(1, 2, 0)
            mean[start : start + step] = total / samples
            spread = (squares - total**2 / samples) / max(samples - 1, 1) / samples
            variance[start : start + step] = np.maximum(spread, 0)
        return mean, variance
