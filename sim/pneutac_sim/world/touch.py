"""What the gel feels: task objects against the resting gel, as a probe grid, an image and a contact area."""

import mujoco
import numpy as np
import trimesh

from pneutac_sim.errors import InputError
from pneutac_sim.gel.contact import ContactArea
from pneutac_sim.gel.probe import COLS, KINDS, MESH, ROWS
from pneutac_sim.gel.sensor import Memory, TactileSensor, branches_of
from pneutac_sim.world.scene import OBJECT_GROUP

MODES = ("image", "area", "probe", "none")


class Touch:
    """The tactile pipeline of a world: object poses -> probe grid -> image and contact area.

    Attributes:
        depth_mm: last probe grid (rows, columns), mm; the mode `probe` has nothing else.
        image: last tactile image uint8 (H, W, 3), or None where the mode has none.
        pixels: last count s of pixels in contact.
        area: s / N.
        network: the gel's, a `GelSurrogate`, or None.
        felt, kinds, sizes: of the geoms that the gel can feel: ids (n,), and for `probe_grid` shapes (n,) and
            sizes (n, 3).
        left_mm: (80, 59) displacement that earlier contacts left in a gel that creeps, or None.
        in_range: whether the last contact was one that the gel's network was trained for.
    """

    def __init__(self, model: mujoco.MjModel, sensor: TactileSensor, mode: str, gel=None):
        """The touch of a world in one of the `MODES`.

        `gel` takes the place of the sensor's own formula: a `GelSurrogate`, or an `MpmGel`, which is shown
        the objects themselves.
        """
        if mode not in MODES:
            raise InputError(f"There is no touch mode '{mode}'; the modes are {', '.join(MODES)}.")
        self.sensor = sensor
        self.in_range, self.left_mm = True, None
        branches = branches_of(sensor.model)
        self._memory = Memory(branches) if branches else None
        self._mode, self.network, self._full = mode, None, None
        if gel is not None:
            sensor.surface = gel.displacement
            self.network, self._full = (gel, None) if hasattr(gel, "out_of_range") else (None, gel)
        self._gel = model.site("gel").id
        self.felt = np.flatnonzero(model.geom_group == OBJECT_GROUP)
        self.kinds = model.geom_type[self.felt]
        self.sizes, sensor.triangles = _shapes(model, self.felt)
        unknown = [model.geom(g).name or "without a name" for g in self.felt[~np.isin(self.kinds, KINDS)]]
        if unknown:
            raise InputError(
                f"The gel cannot feel the shape of geom {', '.join(unknown)}; give it"
                ' class="decor", and class="object" to boxes, cylinders, capsules, spheres, ellipsoids or'
                " meshes where it is touched."
            )
        for g, kind, size in zip(self.felt, self.kinds, self.sizes, strict=True):
            if self._full is not None and kind == MESH and not _closed(sensor.triangles, size):
                raise InputError(
                    "The gel of fidelity=mpm feels closed meshes alone, and that of geom"
                    f" {model.geom(g).name or 'without a name'} is open; close it, or choose another"
                    " fidelity."
                )

    def prepare(self) -> None:
        """Draws a touch that nobody feels: what is compiled at the first one is so before a clock runs.

        Not of material points, which keep pace with no clock.
        """
        if self._mode in ("image", "area") and self._full is None:
            depth_mm = np.zeros((ROWS, COLS), np.float32)
            depth_mm[ROWS // 2, COLS // 2] = 0.5
            self.sensor.contact(self.sensor.image(depth_mm))

    @property
    def displacement_mm(self) -> np.ndarray:
        """How far the gel's face is pressed in now, (80, 59) mm; not in the modes `probe` and `none`."""
        return self.sensor.displacement(self.depth_mm, self.left_mm)

    def objects(self, data: mujoco.MjData) -> tuple[np.ndarray, ...]:
        """What may touch the gel, and the gel's pose, as `gel.probe.probe_grid` takes them."""
        placed = data.geom_xpos[self.felt], data.geom_xmat[self.felt]
        return self.kinds, self.sizes, *placed, data.site_xpos[self._gel], data.site_xmat[self._gel]

    def sense(self, data: mujoco.MjData) -> None:
        """Senses the present state; `data` must have its kinematics up to date."""
        self.image, self.pixels, self.area = None, 0, 0.0
        if self._mode == "none":
            return
        objects = self.objects(data)
        self.depth_mm = self.sensor.probe(*objects)
        if self._mode == "probe":
            return
        if self._full is not None:
            shown = self.depth_mm.any()
            self._full.show(*objects, self.sensor.triangles) if shown else self._full.release()
        if self.network is not None:
            imprint = self.sensor.model.imprint(self.depth_mm)
            self.in_range = not bool(self.network.out_of_range(imprint))
        if self._memory is not None:
            self.left_mm = self._memory.left_mm(float(data.time))
            self._memory.hold(self.displacement_mm if self.depth_mm.any() else None)
        if self._mode == "image":
            self.image = self.sensor.image(self.depth_mm, self.left_mm)
            touched = self.left_mm is not None or self.depth_mm.any()  # else it is the image at rest
            contact = self.sensor.contact(self.image) if touched else ContactArea.of(0, 1)
        else:
            contact = self.sensor.contact_from_depth(self.depth_mm, self.left_mm)
        self.pixels, self.area = contact.pixels, contact.area


def _shapes(model: mujoco.MjModel, geoms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sizes (n, 3) of geoms and the triangles (m, 3, 3) of those that are meshes, for `probe_grid`."""
    sizes, found, count = model.geom_size[geoms], [np.zeros((0, 3, 3))], 0
    for k, g in enumerate(geoms):
        if model.geom_type[g] == MESH:
            mesh = model.mesh(model.geom_dataid[g])
            vertices = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
            found.append(vertices[model.mesh_face[mesh.faceadr[0] :][: mesh.facenum[0]]].astype(float))
            reach = np.linalg.norm(found[-1], axis=2).max()
            sizes[k] = count, len(found[-1]), reach
            count += len(found[-1])
    return sizes, np.concatenate(found)


def _closed(triangles: np.ndarray, size: np.ndarray) -> bool:
    first, count = int(size[0]), int(size[1])
    corners = triangles[first : first + count].reshape(-1, 3)
    return trimesh.Trimesh(corners, np.arange(3 * count).reshape(-1, 3)).is_watertight
