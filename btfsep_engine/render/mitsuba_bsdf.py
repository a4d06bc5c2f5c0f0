# SPDX-License-Identifier: GPL-3.0-or-later
"""The Mitsuba BSDF plugin ``btf``: a factorised BTF in any scene and with any integrator.

    register(mi)
    mi.load_dict({"type": "btf", "filename": "leather.btf"})
    mi.load_dict({"type": "btf", "material": material_key(material), "mean": True})

The look-up is that of the kernel (`render.transport`, `render.appearance`): texels bilinear and periodic, views and
lights barycentric on the parabolic map, the outermost ring held to the horizon, the cosine of the light once. Only
the texels' mip pyramid is missing: a path tracer averages over the pixel by tracing it at many places.

Parameters of the plugin
------------------------
filename : path of a ``.btf`` file
material : a name given by `material_key`, instead of ``filename``
mean : the mean ABRDF instead of the texels (default false)
millimetres_per_uv : millimetres of material in a unit of the shape's texture coordinates (default 1)
texel_mm : edge of a texel in millimetres (default: the material's)
tangents : "uv" (default; the shape's own) or "vertical" (as `surface.with_any_tangent`: at right angles to world z)

Both sides of a surface look alike. Factorised tables can be a little negative; so can what is returned here:
integrators that end paths by chance (Russian roulette) should do so late (``rr_depth``).
"""

import weakref
from functools import lru_cache

import numpy as np

from btfsep_engine.btf import linear
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.errors import InputError
from btfsep_engine.render.arrays import DirectionTaps, dr, floats, mi
from btfsep_engine.render.hemisphere_sampling import LightSampling

NAME = "btf"
SMALLEST_COSINE = 1e-3  # of the eye, as in appearance.LightTables

_held = weakref.WeakValueDictionary()


def material_key(material: Tabulated) -> str:
    """A name under which the plugin finds ``material`` as long as somebody keeps it; the plugin is known then."""
    register(mi)
    key = f"material-{id(material)}"
    _held[key] = material
    return key


def register(mi) -> None:
    """Makes the plugin known to Mitsuba's current variant; doing so again changes nothing.

    ``mi`` : the mitsuba module, with a variant set
    """
    mi.register_bsdf(NAME, plugin_of)


def plugin_of(properties):
    """The plugin of the current variant with these properties."""
    return _plugin_class(mi.variant())(properties)


def material_of(properties) -> Tabulated:
    """The material that a plugin's properties name.

    Raises InputError: neither or both of ``filename`` and ``material``, an unknown name, a file that cannot be read.
    """
    named, filed = "material" in properties, "filename" in properties
    if named == filed:
        raise InputError("plugin 'btf'", f"{'both' if named else 'none'} of filename and material", "give one of them")
    if filed:
        material = linear.read(properties["filename"])
    else:
        material = _held.get(properties["material"])
        if material is None:
            raise InputError(
                "plugin 'btf'",
                f"no material is held as '{properties['material']}'",
                "keep what material_key() was given",
            )
    return material.mean_material() if properties.get("mean", False) else material


@lru_cache(maxsize=4)
def _plugin_class(variant: str):
    """The plugin's class: its base is another one in each variant."""
    if not variant.endswith("_ad_rgb"):
        raise InputError("plugin 'btf'", f"variant {variant}", "use llvm_ad_rgb or cuda_ad_rgb")

    class BTF(mi.BSDF):
        """See the module."""

        def __init__(self, properties):
            mi.BSDF.__init__(self, properties)
            material = material_of(properties)
            texel_mm = properties.get("texel_mm", material.texel_mm)
            per_uv = properties.get("millimetres_per_uv", 1.0)
            self.tangents = properties.get("tangents", "uv")
            if self.tangents not in ("uv", "vertical") or not texel_mm > 0 or not per_uv > 0:
                raise InputError(
                    "plugin 'btf'",
                    f"tangents '{self.tangents}', texel_mm {texel_mm}, millimetres_per_uv {per_uv}",
                    "tangents are 'uv' or 'vertical', sizes are above 0",
                )
            self.name = material.name
            self._upload(material, per_uv / texel_mm)
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            flags |= mi.BSDFFlags.Anisotropic
            if self.textured:
                flags |= mi.BSDFFlags.SpatiallyVarying
            self.m_components, self.m_flags = [flags], flags

        def _upload(self, material, texels_per_uv):
            height, width, k = material.texels.shape
            views, lights = material.angular.shape[:2]
            self.components, self.textured = k, (height, width) != (1, 1)
            self.groups = -(-k // 4)
            # four floats at a time is how Dr.Jit gathers fastest
            texels = np.zeros((height * width, 4 * self.groups), np.float32)
            texels[:, :k] = material.texels.reshape(-1, k)
            angular = np.zeros((views, lights, k, 4), np.float32)
            angular[..., :3] = material.angular.transpose(0, 1, 3, 2)
            self.texels, self.angular = floats(texels), floats(angular)
            self.views = DirectionTaps(material.views)
            self.lights = DirectionTaps(material.lights)
            self.sampling = LightSampling(material)
            # opaque: a kernel that is compiled serves materials of other sizes
            self.width, self.height, self.texels_per_uv = (
                dr.opaque(mi.Float, n) for n in (width, height, texels_per_uv)
            )
            self.light_count = dr.opaque(mi.UInt32, lights)

        def _frame(self, si):
            """The material's axes in the shading frame, and the flat normal there, on the side that ``si.wi`` is on."""
            flat = si.to_local(si.n)
            flat = dr.select(dr.squared_norm(flat) > 0, flat, mi.Vector3f(0, 0, 1))  # none given
            flat = dr.select(dr.dot(flat, si.wi) < 0, -flat, flat)
            normal = mi.Vector3f(0, 0, dr.select(flat.z < 0, mi.Float(-1), 1))
            if self.tangents == "uv":
                # mirrored charts are left-handed, as in parametrise.tangent_frames
                mirrored = dr.dot(dr.cross(si.dp_du, si.dp_dv), si.n) < 0
                tangent = mi.Vector3f(1, 0, 0)
                bitangent = dr.cross(normal, tangent) * dr.select(mirrored, mi.Float(-1), 1)
            else:
                tangent = dr.cross(si.to_local(mi.Vector3f(0, 0, 1)), normal)
                length = dr.norm(tangent)
                level = length > 1e-6
                other = si.to_local(mi.Vector3f(1, 0, 0))
                other = dr.normalize(other - normal * dr.dot(other, normal))
                tangent = dr.select(level, tangent / dr.select(level, length, 1), other)
                bitangent = dr.cross(normal, tangent)
            return tangent, bitangent, normal, flat

        @staticmethod
        def _in(frame, w):
            return mi.Vector3f(*(dr.dot(axis, w) for axis in frame[:3]))

        @staticmethod
        def _eye(local):
            return dr.normalize(mi.Vector3f(local.x, local.y, dr.maximum(local.z, SMALLEST_COSINE)))

        def _texel_taps(self, si):
            """Indices and weights of the four texels around the surface point."""
            if not self.textured:
                return [mi.UInt32(0)], [mi.Float(1)]
            x, y = si.uv.x * self.texels_per_uv - 0.5, si.uv.y * self.texels_per_uv - 0.5
            column, row = dr.floor(x), dr.floor(y)
            fx, fy = x - column, y - row

            def wrapped(number, size):
                # in floats: an integer division by the 0 of a lane that is switched off would end the process
                return mi.UInt32(number - dr.floor(number / size) * size)

            columns = [wrapped(column, self.width), wrapped(column + 1, self.width)]
            rows = [wrapped(row, self.height), wrapped(row + 1, self.height)]
            return (
                [r * mi.UInt32(self.width) + c for r in rows for c in columns],
                [wy * wx for wy in (1 - fy, fy) for wx in (1 - fx, fx)],
            )

        def _factors(self, si, active):
            """The spatial factor at the surface point: one Float a component."""
            indices, weights = self._texel_taps(si)
            out = []
            for group in range(self.groups):
                total = mi.Vector4f(0)
                for index, weight in zip(indices, weights, strict=True):
                    total += weight * dr.gather(mi.Vector4f, self.texels, index * self.groups + group, active)
                out += [total.x, total.y, total.z, total.w]
            return out[: self.components]

        def _value(self, si, eye_taps, light, active):
            """The BTF without the cosine, at the eye's taps and a local light direction."""
            factors = self._factors(si, active)
            light_indices, light_weights = self.lights.normalised(light, active)
            total = mi.Vector4f(0)
            for view, view_weight in zip(*eye_taps, strict=True):
                for number, light_weight in zip(light_indices, light_weights, strict=True):
                    base = (view * self.light_count + number) * self.components
                    value = mi.Vector4f(0)
                    for k, factor in enumerate(factors):
                        value += factor * dr.gather(mi.Vector4f, self.angular, base + k, active)
                    total += view_weight * light_weight * value
            return mi.Color3f(total.x, total.y, total.z)

        def _evaluated(self, ctx, si, wo, active, *, value=True):
            """Value with the cosine and density of a direction; ``value`` false: the density alone."""
            frame = self._frame(si)
            wi_local, wo_local = self._in(frame, si.wi), self._in(frame, wo)
            if not ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0):
                return mi.Color3f(0), mi.Float(0)
            # light from behind the flat surface does not arrive, whatever the shading normal says
            seen = active & (wo_local.z > 0) & (dr.dot(frame[3], wo) > 0)
            importance = ctx.mode == mi.TransportMode.Importance
            eye, light = (wo_local, wi_local) if importance else (wi_local, wo_local)
            light = mi.Vector3f(light.x, light.y, dr.maximum(light.z, 0))
            eye_taps = self.views.normalised(self._eye(eye), seen)
            colour = mi.Color3f(0)
            if value:
                colour = dr.select(seen, self._value(si, eye_taps, light, seen) * wo_local.z, mi.Color3f(0))
            if importance:  # nothing is tabulated by light: along the cosine
                return colour, dr.select(active & (wo_local.z > 0), wo_local.z / dr.pi, 0)
            above = active & (wo_local.z > 0)
            taps = self.views.normalised(self._eye(wi_local), above)
            return colour, self.sampling.pdf(*taps, wo_local, above)

        def eval(self, ctx, si, wo, active=True):
            return self._evaluated(ctx, si, wo, mi.Bool(active))[0]

        def pdf(self, ctx, si, wo, active=True):
            return self._evaluated(ctx, si, wo, mi.Bool(active), value=False)[1]

        def eval_pdf(self, ctx, si, wo, active=True):
            return self._evaluated(ctx, si, wo, mi.Bool(active))

        def sample(self, ctx, si, sample1, sample2, active=True):
            active = mi.Bool(active)
            drawn = dr.zeros(mi.BSDFSample3f)
            if not ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0):
                return drawn, mi.Color3f(0)
            frame = self._frame(si)
            if ctx.mode == mi.TransportMode.Importance:
                local = mi.warp.square_to_cosine_hemisphere(sample2)
            else:
                taps = self.views.normalised(self._eye(self._in(frame, si.wi)), active)
                local = self.sampling.draw(*taps, sample1, sample2, active)
            drawn.wo = frame[0] * local.x + frame[1] * local.y + frame[2] * local.z
            value, drawn.pdf = self._evaluated(ctx, si, drawn.wo, active)
            drawn.eta = 1
            drawn.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            drawn.sampled_component = mi.UInt32(0)
            good = active & (drawn.pdf > 0)
            return drawn, dr.select(good, value / drawn.pdf, mi.Color3f(0))

        def to_string(self):
            return f"BTF[{self.name}, {self.components} components, tangents {self.tangents}]"

    return BTF
