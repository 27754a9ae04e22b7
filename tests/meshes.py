"""Meshes and bodies for tests, made in code, and Gmsh files written from them."""

from dataclasses import replace

import meshio
import numpy as np
import scipy.sparse.linalg
import skfem

import sweepopt as so
from sweepopt.fem import (
    BodyForce,
    Elasticity,
    Friction,
    Viscosity,
    antiplane,
    body,
)
from sweepopt.fem.contact import slip_of
from sweepopt.fem.output import Report


def square(n):
    """(0, 1)^2 in n by n squares; boundaries left, bottom, right, top."""
    grid = np.linspace(0.0, 1.0, n + 1)
    return skfem.MeshTri.init_tensor(grid, grid).with_defaults()


def annulus(n, *, curved=True):
    """1 < r < 2 in n rings; boundaries inner and outer, subdomains core (r < 1.5) and sleeve."""
    turns = 9 * n
    r, k = np.meshgrid(np.linspace(1.0, 2.0, n + 1), np.arange(turns), indexing="ij")
    point = np.arange(r.size).reshape(r.shape)
    a, b = point[:-1], point[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    t = np.hstack([[x.ravel() for x in corners] for corners in ((a, b, c), (a, c, d))])
    polar = np.stack([r.ravel(), 2.0 * np.pi * k.ravel() / turns])
    mesh = skfem.MeshTri(_cartesian(polar), t)
    if curved:
        mesh = skfem.MeshTri2.from_mesh(mesh)
        start, end = polar[:, mesh.facets[0]], polar[:, mesh.facets[1]]
        turn = np.mod(end[1] - start[1] + np.pi, 2.0 * np.pi) - np.pi
        x = mesh.doflocs.copy()
        x[:, mesh.dofs.facet_dofs[0]] = _cartesian(
            np.stack([(start[0] + end[0]) / 2.0, start[1] + turn / 2.0])
        )
        mesh = replace(mesh, doflocs=x)
    edges = mesh.boundary_facets()
    outside = np.hypot(*mesh.p[:, mesh.facets[0, edges]]) > 1.5
    inside = np.hypot(*mesh.p[:, mesh.t].mean(axis=1)) < 1.5
    return mesh.with_boundaries(
        {"inner": edges[~outside], "outer": edges[outside]}
    ).with_subdomains({"core": np.flatnonzero(inside), "sleeve": np.flatnonzero(~inside)})


def ring(**changes):
    """A quadratic ring of two materials in SI units: glued inside, friction outside."""
    effects = [
        Viscosity({"core": 2.0, "sleeve": 1.0}),
        Elasticity(2.0),
        Friction("outer", g=0.6),
        BodyForce(so.Sine(4.0, period=4.0), f0=lambda x: 1.0 + 0.4 * x[0]),
    ]
    settings = {"clamped": "inner", "element": "P2", "effects": effects}
    settings |= {"t_end": 6.0, "steps": 60, "units": "SI", "title": "a ring"}
    settings |= changes
    return antiplane(settings.pop("mesh", None) or annulus(2), **settings)


def smooth():
    """A square without friction or units."""
    effects = [Viscosity(1.0), BodyForce(so.Sine(1.0, period=4.0))]
    return antiplane(square(4), clamped="top", effects=effects, t_end=1.0, steps=4)


def report_of(scene, **more):
    """The scene and its run, as what is written of them sees them."""
    return Report(scene, scene.solve(), **more)


def at_rest(space, effects):
    """Displacements of the nodes in equilibrium with the load at t = 0."""
    scene = body(space, effects)
    u = scipy.sparse.linalg.spsolve(scene.problem.B, scene.load(0.0))
    return scene.discretisation.expand(u)


def run_of(space, effects, **how):
    """A body and its run of implicit Euler until t = 1 in two steps, unless said otherwise."""
    scene = body(space, effects)
    how = {"t_end": 1.0, "steps": 2, "scheme": "implicit-euler"} | how
    return scene, scene.solve(**how)


def slips(space, effects, **how):
    """What slips in such a run."""
    return slip_of(*run_of(space, effects, **how))


def end_of(space, effects, **how):
    """Displacements of the nodes at its end."""
    scene, run = run_of(space, effects, **how)
    return scene.displacement(run)[-1]


def errors(body, u, exact, gradient):
    """|u_h - exact| and |grad u_h - gradient| in L^2, by a quadrature that is not seen in them."""
    basis = skfem.CellBasis(body.mesh, body.basis.elem, intorder=8)
    x, field = np.asarray(basis.global_coordinates()), basis.interpolate(body.expand(u))
    missed = np.asarray(field) - exact(x), np.asarray(field.grad) - gradient(x)
    value, slope = (float(np.sqrt(np.sum(one**2 * basis.dx))) for one in missed)
    return value, slope


def _cartesian(polar):
    return np.stack([polar[0] * np.cos(polar[1]), polar[0] * np.sin(polar[1])])


def write_msh(path, mesh):
    """Write a mesh with its boundaries and subdomains as physical groups."""
    curved = isinstance(mesh, skfem.MeshTri2)
    line, triangle = ("line3", "triangle6") if curved else ("line", "triangle")
    lines = np.vstack([mesh.facets, mesh.dofs.facet_dofs]) if curved else mesh.facets
    cells, names = [], {}
    for name, members in (mesh.boundaries or {}).items():
        names[name] = np.array([len(names) + 1, 1])
        cells.append((line, lines[:, np.asarray(members)].T))
    for name, members in (mesh.subdomains or {"all": slice(None)}).items():
        names[name] = np.array([len(names) + 1, 2])
        cells.append((triangle, (mesh.dofs.element_dofs if curved else mesh.t).T[members]))
    tags = [np.full(len(nodes), number) for number, (_, nodes) in enumerate(cells, start=1)]
    raw = meshio.Mesh(
        np.pad(mesh.doflocs.T, ((0, 0), (0, 1))),
        cells,
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data=names,
    )
    meshio.write(path, raw, file_format="gmsh22", binary=False)
    return path
