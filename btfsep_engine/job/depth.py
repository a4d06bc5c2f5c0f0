# SPDX-License-Identifier: GPL-3.0-or-later
"""A surface from a depth image."""

from dataclasses import replace

import numpy as np

from btfsep_engine.job.model import Camera, TriangleMesh

STEEP = 2.0  # a step of more pixel footprints than this may be a discontinuity …
JUMP = 4.0  # … if it is also this many times its neighbours' steps
CLIFF = 25.0  # beyond it, it is one always (88 degrees)
NOTHING = 1e10  # what Blender's Z pass holds where nothing is, and infinity
REACH = 2  # pixels; normals come from windows of 5 x 5
QUIET = 0.05  # pixel footprints of noise in the depth: what a smooth shape shows itself, and a float's rounding
NOISE_OF_A_PASS = 0.25  # pixel footprints of noise for each pass of smoothing
MOST_PASSES = 8  # of smoothing
BEHIND = 0.5  # how far the unseen side goes on behind what is seen deepest, of half the surface's diagonal
AFAR = 1e6  # extents: where a pinhole that stands for an orthographic camera is
GAP = 0.1  # pixel footprints between the surface and what closes it: rays of the camera meet the surface first


def mesh_from_depth(depth, camera: Camera) -> TriangleMesh | None:
    """Triangles between the centres of neighbouring pixels that belong to one surface.

    Parameters
    ----------
    depth : (h, w) float, z-depth along the view axis, world units; 0, or `NOTHING` and more, where nothing is
    camera : of the same size

    Returns
    -------
    TriangleMesh without uv, or None where no three neighbouring pixels make a triangle. Normals are those of planes
    fitted to the inverse depth around each pixel: on a plane 1/z is linear in the image, so a slanted plane has
    exact normals however noisy steps between single pixels are. A noisy depth is smoothed before.
    """
    camera, z, inverse, valid, across, down = _surface(depth, camera)
    faces = _triangles(inverse, across, down)
    if not len(faces):
        return None
    rays = _rays(camera)
    local = z[..., None] * rays
    normals = _normals(rays[..., 0], rays[..., 1], inverse, valid, across, down)
    used, faces = _compact(faces)
    rotation, origin = camera.to_world[:3, :3], camera.to_world[:3, 3]
    vertices = local.reshape(-1, 3)[used] @ rotation.T + origin
    normals = normals.reshape(-1, 3)[used] @ rotation.T
    return TriangleMesh(vertices, faces, normals[faces].astype(np.float32), None)


def closing_mesh(depth, camera: Camera) -> TriangleMesh | None:
    """What a surface of `mesh_from_depth` lacks to be a body: all that lies behind what is seen is taken as solid.

    A camera sees one side. Without the other, light that no body lets through comes from behind, through steps in the
    depth and past the outline, and shines on the back of what is seen. Three parts close it, none of which can hide
    anything from the camera: triangles over the steps that `mesh_from_depth` cuts; walls from the outline straight away
    from the camera, to a plane behind everything; and what they enclose of that plane, holes included.

    Parameters
    ----------
    depth, camera : as for `mesh_from_depth`

    Returns
    -------
    TriangleMesh with the triangles' own normals, or None where there is no surface
    """
    camera, z, inverse, valid, *links = _surface(depth, camera)
    h, w = z.shape
    across, down = valid[:, 1:] & valid[:, :-1], valid[1:] & valid[:-1]
    body = _triangles(inverse, across, down)
    if not len(body):
        return None
    outline = _outline(body, h * w)
    steps = _triangles(inverse, across, down, without=_squares(*links))
    used, faces = _compact(np.concatenate([steps.ravel(), outline.ravel()]))
    steps, (a, b) = faces[: -outline.size].reshape(-1, 3), faces[-outline.size :].reshape(-1, 2).T

    rays = _rays(camera)
    corners = (rays * z[..., None])[valid]
    far = z[valid].max() + BEHIND * np.linalg.norm(np.ptp(corners, 0)) / 2
    near = z.ravel()[used] * (1 + GAP / camera.focal)
    ends = rays.reshape(-1, 3)[used] * far
    from scipy.ndimage import binary_fill_holes  # slow to import, and most jobs have meshes

    count, back = len(used), _rectangles(binary_fill_holes(_squares_of(body, h, w)))
    faces = np.concatenate(
        [
            steps,
            np.stack([b, a, a + count], -1),
            np.stack([b, a + count, b + count], -1),
            2 * count + np.arange(len(back) * 4).reshape(-1, 4)[:, [0, 1, 2, 1, 3, 2]].reshape(-1, 3),
        ]
    ).astype(np.int32)
    back = rays[back[..., 0], back[..., 1]].reshape(-1, 3) * far
    local = np.concatenate([rays.reshape(-1, 3)[used] * near[:, None], ends, back])
    vertices = local @ camera.to_world[:3, :3].T + camera.to_world[:3, 3]
    p = vertices[faces]
    normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    length = np.linalg.norm(normals, axis=-1)
    faces, normals = faces[length > 0], normals[length > 0] / length[length > 0, None]
    return TriangleMesh(vertices, faces, np.repeat(normals[:, None], 3, 1).astype(np.float32), None)


def shifted_mask(mask, right: float, down: float) -> np.ndarray:
    """A mask (h, w) bool of a depth as a photo shows it that is shifted against it: by whole pixels, false outside."""
    return _shifted(np.asarray(mask), -round(right), -round(down))


def _surface(depth, camera: Camera):
    """What both meshes are made of: a pinhole, and as it sees them, (h, w), z-depth (0 where nothing is), its inverse
    (0), where it is, and its links.

    A noisy depth (a sensor's, or one of few bits) is smoothed: rough surfaces shade themselves.
    """
    z = np.asarray(depth, np.float64)
    valid = (z > 0) & (z < NOTHING)
    z = np.where(valid, z, 0)
    if camera.orthographic:
        camera, back = _from_afar(camera, z)
        z = np.where(valid, z + back, 0)
    inverse = np.where(valid, 1 / np.where(valid, z, 1), 0.0)
    across = _connected(z, inverse, valid, 1, camera.fx)
    down = _connected(z, inverse, valid, 0, camera.fy)
    noise = _noise(z, inverse, across, down, camera.focal)
    if noise > QUIET:
        inverse = _smoothed(
            inverse, valid, across, down, passes=min(int(np.ceil(noise / NOISE_OF_A_PASS)), MOST_PASSES)
        )
        z = np.where(valid, 1 / np.where(valid, inverse, 1), 0)
    return camera, z, inverse, valid, across, down


def _from_afar(camera: Camera, z):
    """An orthographic camera as a pinhole that stands so far back that no pixel can tell, and how far."""
    back = AFAR * max(float(z.max(initial=0)), camera.width / camera.fx, camera.height / camera.fy)
    to_world = camera.to_world.copy()
    to_world[:3, 3] += back * to_world[:3, 2]
    middle = back + float(np.median(z[z > 0])) if (z > 0).any() else back
    return replace(camera, fx=camera.fx * middle, fy=camera.fy * middle, to_world=to_world, orthographic=False), back


def _rays(camera: Camera):
    """(h, w, 3) camera-space directions through the pixels' centres, of length 1 along the view axis."""
    return camera.local_points(np.arange(camera.width) + 0.5, np.arange(camera.height)[:, None] + 0.5)


def _squares(across, down):
    """(h - 1, w - 1) bool: which squares of four neighbours are connected all around."""
    return across[:-1] & across[1:] & down[:, :-1] & down[:, 1:]


def _compact(faces):
    """The numbers that occur, ascending, and the faces in these (as int32)."""
    used, small = np.unique(faces, return_inverse=True)
    return used, small.reshape(faces.shape).astype(np.int32)


def _outline(faces, count: int):
    """(e, 2) edges that belong to one triangle only, in its direction; ``count`` : above every number."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = edges.min(1) * count + edges.max(1)
    _, first, times = np.unique(key, return_index=True, return_counts=True)
    return edges[first[times == 1]]


def _squares_of(faces, h: int, w: int):
    """(h - 1, w - 1) bool: which squares of four neighbours have a triangle; ``faces`` (f, 3) numbers of pixels."""
    out = np.zeros((h - 1, w - 1), bool)
    out[(faces // w).min(1), (faces % w).min(1)] = True
    return out


def _rectangles(squares):
    """Squares (h - 1, w - 1) bool as rectangles one row high: (n, 4, 2) row and column of their corners' pixels."""
    edges = np.diff(np.pad(squares, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    rows, left = np.nonzero(edges > 0)
    _, right = np.nonzero(edges < 0)
    corners = [(rows, left), (rows, right), (rows + 1, left), (rows + 1, right)]
    return np.stack([np.stack(c, -1) for c in corners], 1)


def _triangles(inverse, across, down, *, without=None):
    """(f, 3) numbers of pixels: triangles over squares of connected neighbours, but in squares ``without``."""
    h, w = inverse.shape
    number = np.arange(h * w).reshape(h, w)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]  # a b over c d
    top, bottom, left, right = across[:-1], across[1:], down[:, :-1], down[:, 1:]
    whole = _squares(across, down)
    # the diagonal that spans the smaller step in depth
    falling = np.abs(inverse[:-1, :-1] - inverse[1:, 1:]) <= np.abs(inverse[:-1, 1:] - inverse[1:, :-1])
    first, second = ~whole & left & bottom, ~whole & top & right  # of a broken square one triangle at most
    spare = ~(whole | first | second)
    faces = []
    for chosen, corners in (
        ((whole & falling) | first, (a, c, d)),
        ((whole & falling) | second, (a, d, b)),
        ((whole & ~falling) | (spare & left & top), (a, c, b)),
        ((whole & ~falling) | (spare & right & bottom), (b, c, d)),
    ):
        chosen = chosen if without is None else chosen & ~without
        faces.append(np.stack([k[chosen] for k in corners], -1))
    return np.concatenate(faces)


def _connected(z, inverse, valid, axis: int, focal: float):
    """Whether neighbours along an axis are on one surface: bool, one shorter along that axis."""
    ahead = [slice(None)] * 2
    behind = [slice(None)] * 2
    ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
    ahead, behind = tuple(ahead), tuple(behind)
    both = valid[ahead] & valid[behind]
    nearer = np.minimum(np.where(valid[ahead], z[ahead], np.inf), np.where(valid[behind], z[behind], np.inf))
    with np.errstate(invalid="ignore", over="ignore"):
        # in pixel footprints: the tangent of the slope against the image plane
        step = np.where(both, np.abs(z[ahead] - z[behind]) / np.where(both, nearer, 1) * focal, np.inf)
        change = np.where(both, np.abs(inverse[ahead] - inverse[behind]), np.inf)
    pad = [(0, 0), (0, 0)]
    pad[axis] = (1, 1)
    around = np.pad(change, pad, constant_values=np.inf)
    before, after = (
        around[tuple(slice(s, s + change.shape[i]) if i == axis else slice(None) for i in (0, 1))] for s in (0, 2)
    )
    around = np.where(np.isinf(before), after, np.where(np.isinf(after), before, np.maximum(before, after)))
    sudden = ~np.isinf(around) & (change > JUMP * around)
    return both & (step < CLIFF) & ((step < STEEP) | ~sudden)


def _noise(z, inverse, across, down, focal: float) -> float:
    """Noise of the depth in pixel footprints, from fourth differences: a shape has next to none of them.

    (Of second ones a ball of a dozen pixels has as much as noise of a twentieth of a footprint.)
    """
    found = []
    for a, n, links in ((inverse, z, across), (inverse.T, z.T, down.T)):
        joined = links[:, 3:] & links[:, 2:-1] & links[:, 1:-2] & links[:, :-3]
        found.append((np.abs(np.diff(a, 4, axis=1)) * n[:, 2:-2])[joined])
    found = np.concatenate(found)
    return float(np.median(found) / (0.6745 * np.sqrt(70)) * focal) if len(found) else 0.0


def _smoothed(inverse, valid, across, down, *, passes: int):
    """The inverse depth as means over 3 x 3 pixels of one surface, ``passes`` times; a plane stays as it is.

    Neighbours count in opposite pairs: a mean of two that lie on a line with the pixel is right on a slope, too.
    """
    ways = (1, 0), (0, 1), (1, 1), (1, -1)
    pairs = [_reached(valid, across, down, i, j) & _reached(valid, across, down, -i, -j) for i, j in ways]
    for _ in range(passes):
        total, count = inverse.copy(), np.ones_like(inverse)
        for (i, j), pair in zip(ways, pairs, strict=True):
            total += np.where(pair, _shifted(inverse, i, j) + _shifted(inverse, -i, -j), 0)
            count += 2 * pair
        inverse = total / count
    return inverse


def _normals(x, y, inverse, valid, across, down):
    """(h, w, 3) camera-space unit normals towards the camera, from planes fitted to 1/z in a window.

    With P = z (X, Y, -1), a plane n . P = 1 means 1/z = n . (X, Y, -1): least squares for n, linear in the image.
    Neighbours count where a chain of connected pixels leads to them, columns first or rows first.
    """
    h, w = valid.shape
    # of the coordinates per pixel down and right; behind a lens they differ from place to place
    (x_down, x_right), (y_down, y_right) = np.gradient(x), np.gradient(y)
    moments = np.zeros((h, w, 3, 3))
    values = np.zeros((h, w, 3))
    for j in range(-REACH, REACH + 1):
        for i in range(-REACH, REACH + 1):
            weight = _reached(valid, across, down, i, j).astype(np.float64)
            there = _shifted(inverse, i, j) - inverse
            f = np.array([i, j, 1.0])
            moments += weight[..., None, None] * np.outer(f, f)
            values += (weight * there)[..., None] * f
    moments += 1e-9 * np.eye(3)
    slope = np.linalg.solve(moments, values[..., None])[..., 0]  # change of 1/z per pixel right, per pixel down
    right, below, area = slope[..., 0], slope[..., 1], x_right * y_down - y_right * x_down
    nx, ny = (right * y_down - below * y_right) / area, (below * x_right - right * x_down) / area
    nz = nx * x + ny * y - (inverse + slope[..., 2])  # so that n . (X, Y, -1) is 1/z here
    normals = -np.stack([nx, ny, nz], -1)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(length > 0, normals / np.where(length > 0, length, 1), np.array([0.0, 0.0, 1.0]))


def _shifted(array, i: int, j: int):
    """The array whose element (y, x) is that at (y + j, x + i), zero (or false) outside."""
    out = np.zeros_like(array)
    h, w = array.shape
    if abs(i) < w and abs(j) < h:
        out[max(0, -j) : h - max(0, j), max(0, -i) : w - max(0, i)] = array[
            max(0, j) : h - max(0, -j), max(0, i) : w - max(0, -i)
        ]
    return out


def _reached(valid, across, down, i: int, j: int):
    """(h, w) bool: whether the pixel (i, j) away is connected to this one, going one way or the other."""
    h, w = valid.shape
    wide = np.zeros((h, w), bool)
    wide[:, :-1] = across
    tall = np.zeros((h, w), bool)
    tall[:-1] = down

    def run(links, steps, horizontal, offset):
        ok = valid
        for k in range(abs(steps)):
            at = k if steps > 0 else -k - 1
            ok = ok & (_shifted(links, at, offset) if horizontal else _shifted(links, offset, at))
        return ok

    return (run(wide, i, True, 0) & run(tall, j, False, i)) | (run(tall, j, False, 0) & run(wide, i, True, j))
