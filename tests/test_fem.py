"""The antiplane forms, the lumped friction and the two reference problems with known solutions."""

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
import skfem
from cases import refuses, slope
from meshes import annulus, errors, square, write_msh
from numpy.testing import assert_allclose, assert_array_equal

from sweepopt import Constant, Sine
from sweepopt.fem import (
    BodyForce,
    Discretisation,
    Elasticity,
    Friction,
    Profile,
    Traction,
    Viscosity,
    antiplane,
    body,
    grid,
    read_mesh,
)
from sweepopt.fem.mesh import check_mesh, refined


def order(errors, ratio=2.0):
    """Observed orders between neighbouring refinements."""
    errors = np.asarray(errors)
    return np.log(errors[:-1] / errors[1:]) / np.log(ratio)


# ---- forms --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "element, v, c, energy, inside, at_right",
    [
        ("P1", "3 * y", "1 + x + 2 * y", 22.5, 3.5, 2.5),
        ("P2", "y * (1 + x)", "3", 8.0, 41 / 24, 5 / 3),
    ],
)
def test_forms_are_exact_on_polynomials(element, v, c, energy, inside, at_right):
    """Integrals of c |grad v|^2 and of f v with f = 2 - x^2 + y, over the square and its side."""
    f = "2 - x**2 + y"
    forces = [BodyForce(Constant(), f0=f), Traction("right", Constant(), f2=f)]
    effects = [Viscosity(c), Elasticity(f"2 * ({c})"), *forces]
    scene = antiplane(square(3), clamped="bottom", element=element, effects=effects)
    u, problem = scene.discretisation.interpolate(v), scene.problem
    forces = [shape @ u for _, shape in problem.load.terms]
    found = [u @ problem.A @ u, u @ problem.B @ u, *forces]
    assert found == pytest.approx([energy, 2 * energy, inside, at_right], rel=1e-13)


def test_coefficients_by_group_profile_and_function_agree():
    profile = Profile("radius", [0.9, 1.5 - 1e-9, 1.5 + 1e-9, 2.1], [1.0, 1.0, 3.0, 3.0])
    by_group, by_function, by_profile = (
        antiplane(annulus(2), clamped="inner", effects=[Viscosity(eta)]).problem.A
        for eta in (
            {"core": 1.0, "sleeve": 3.0},
            lambda x: np.where(np.hypot(*x) < 1.5, 1.0, 3.0),
            profile,
        )
    )
    assert abs(by_group - by_function).max() < 1e-13
    assert abs(by_group - by_profile).max() < 1e-13


@pytest.mark.parametrize(
    "along, expected",
    [("x", [1, 0, -2, 0]), ("y", [0, 1, 0, -2]), ("radius", [1, 1, 2, 2])]
    + [("angle", [0, 90, 180, 270])],
)
def test_a_profile_runs_along_x_y_radius_or_angle(along, expected):
    x = np.array([[1.0, 0.0, -2.0, 0.0], [0.0, 1.0, 0.0, -2.0]])
    assert_allclose(Profile(along, [-9.0, 400.0], [-9.0, 400.0])(x), expected)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_triangles_for_pictures_tile_the_body(element):
    space = Discretisation(annulus(4), "inner", element)
    a, b, c = np.moveaxis(space.points[space.triangles], 1, 0)
    area = np.abs(np.linalg.det(np.stack([b - a, c - a], axis=1))).sum() / 2
    assert area == pytest.approx(3 * np.pi, rel=1e-2)


# ---- friction -----------------------------------------------------------------------------------


def with_friction(mesh, clamped, on, g=1.0, element="P1"):
    effects = [Viscosity(1.0), Friction(on, g)]
    return antiplane(mesh, clamped=clamped, element=element, effects=effects)


@pytest.mark.parametrize("element, expected", [("P1", 2), ("P2", 4)])
def test_the_dissipation_is_the_lumped_functional_and_has_its_stated_order(element, expected):
    errors = []
    for n in (4, 8, 16, 32):
        scene = with_friction(square(n), "top", "bottom", "1 + x**2", element)
        v = scene.discretisation.interpolate("exp(x) * (1 - y)")
        J, contact = scene.problem.dissipation.support(v), scene.contact
        by_hand = np.sum(contact.weight * contact.bound * np.abs(v[contact.unknown]))
        assert pytest.approx(by_hand, rel=1e-14) == J
        errors.append(abs(J - (2 * np.e - 3)))  # int (1 + x^2) e^x
    assert np.all(order(errors) > expected - 0.1)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_contact_nodes_follow_the_boundary_with_the_body_on_the_left(element):
    outer = with_friction(annulus(4), "inner", "outer", element=element).contact
    angle = np.arctan2(outer.points[:, 1], outer.points[:, 0]) % (2 * np.pi)
    assert_allclose(outer.arc, 2 * angle, atol=0.05)
    assert np.all(np.diff(angle) > 0)
    corner = with_friction(square(3), "top", ["left", "bottom"], element=element).contact
    left = corner.boundary == "left"
    expected = np.where(left, 1 - corner.points[:, 1], 1 + corner.points[:, 0])
    assert_allclose(expected, corner.arc, atol=1e-12)
    assert list(dict.fromkeys(corner.boundary)) == ["left", "bottom"]
    assert np.all(np.diff(corner.arc[left]) > 0)


def test_nodes_without_friction_and_clamped_nodes_are_no_contact():
    contact = with_friction(square(4), "right", "bottom", "maximum(x - 0.5, 0)").contact
    assert_allclose(contact.points[:, 0], [0.75])


# ---- reference problems -------------------------------------------------------------------------

ETA, KAPPA, G, F, OMEGA, END = 1.0, 2.0, 0.6, 2.0, 1.5, 6.0
LOG2 = np.log(2.0)


def annulus_scene(n, element):
    force = BodyForce(Sine(1.0, period=2 * np.pi / OMEGA), f0=F)
    effects = [Viscosity(ETA), Elasticity(KAPPA), Friction("outer", g=G), force]
    return antiplane(annulus(n), clamped="inner", element=element, effects=effects)


def midpoint_amplitudes(steps):
    """alpha, beta of u = alpha log r / log 2 + beta chi in the midpoint scheme, at the grid times.

    The two modes are a-orthogonal and only the first moves the contact, so the scheme itself
    splits: what is left in the comparison is the error of the elements alone.
    """
    k, Q = 2 * np.pi / LOG2, 2 * np.pi * F * (2 - 3 / (4 * LOG2))
    mu = END / steps
    alpha, beta = np.zeros(steps + 1), np.zeros(steps + 1)
    for i in range(steps):
        s = np.sin(OMEGA * (i + 0.5) * mu)
        q = Q * s - KAPPA * k * alpha[i]
        slip = np.sign(q) * max(abs(q) - 4 * np.pi * G, 0.0) / (k * (ETA + mu / 2 * KAPPA))
        alpha[i + 1] = alpha[i] + mu * slip
        beta[i + 1] = beta[i] + mu * (s - KAPPA * beta[i]) / (ETA + mu / 2 * KAPPA)
    return alpha, beta


def annulus_field(alpha, beta):
    """u and grad u for given amplitudes."""

    def u(x):
        r = np.hypot(*x)
        return alpha * np.log(r) / LOG2 + beta * F * ((1 - r**2) / 4 + 0.75 * np.log(r) / LOG2)

    def gradient(x):
        r = np.hypot(*x)
        return (alpha / (r * LOG2) + beta * F * (-r / 2 + 0.75 / (r * LOG2))) * x / r

    return u, gradient


@pytest.mark.parametrize(
    "element, rings, orders, ceilings",
    [
        ("P1", (2, 4, 8), (2, 1), (6.0e-3, 0.102)),
        ("P2", (2, 4, 8), (3, 2), (3.2e-5, 1.7e-3)),
    ],
)
def test_annulus_with_curved_elements_converges_in_u_and_velocity(element, rings, orders, ceilings):
    steps = 40
    alpha, beta = midpoint_amplitudes(steps)
    mu = END / steps
    moments = (13, 26, 38)  # slipping out, after one reversal, and after the next
    measured = []
    for n in rings:
        scene = annulus_scene(n, element)
        body = scene.discretisation
        sol = scene.solve(t_end=END, steps=steps, scheme="midpoint", tol=1e-9)
        worst = np.zeros(4)
        for i in moments:
            rates = (alpha[i] - alpha[i - 1]) / mu, (beta[i] - beta[i - 1]) / mu
            found = (
                *errors(body, sol.u[i], *annulus_field(alpha[i], beta[i])),
                *errors(body, sol.velocity[i - 1], *annulus_field(*rates)),
            )
            worst = np.maximum(worst, found)
        measured.append(worst)
    slopes = slope(rings, measured)
    assert np.all(slopes > np.tile(orders, 2) - 0.1), (slopes, measured)
    assert np.all(measured[-1][:2] < ceilings), measured


ZONE = {  # u(x, 0, t) at x = 0, 0.25, 0.5, 0.75, to about 3e-8
    1: (0.158170147, 0.124574482, 0.051006888, 0.002067357),
    2: (0.567444781, 0.476273638, 0.259868299, 0.056872947),
    3: (0.582964023, 0.488693609, 0.265210891, 0.057056287),
    4: (0.217491926, 0.201987253, 0.149929996, 0.052942727),
}


def zone_errors(n, element, steps):
    """The error at the tabulated points for each tabulated time."""

    f0 = "0.45 * pi**2 * sin(pi * y) * (1 + 2 * cos(pi * x))"
    force = BodyForce(Sine(1.0, period=2 * np.pi), f0)
    effects = [Viscosity(1.0), Elasticity(1.0), Friction("bottom", g=1.0), force]
    scene = antiplane(square(n), clamped="top", element=element, effects=effects)
    sol = scene.solve(t_end=4.0, steps=steps, scheme="midpoint", tol=1e-8)
    arc, unknown, at = scene.contact.arc, scene.contact.unknown, [0, 0.25, 0.5, 0.75]
    return [
        np.abs(np.interp(at, arc, sol.u[t * steps // 4][unknown]) - values).max()
        for t, values in ZONE.items()
    ]


@pytest.mark.parametrize(
    "element, sizes, steps, at_end, everywhere, rate",
    [
        ("P1", (8, 16, 32, 64), 200, (1.9e-3, 4.2e-4, 1.0e-4, 2.9e-5), 1.6e-4, 1.9),
        ("P2", (4, 8, 16), 400, (1.5e-3, 1.75e-4, 1.4e-5), 7e-5, 3.0),
    ],
)
def test_a_spreading_and_reversing_slip_zone(element, sizes, steps, at_end, everywhere, rate):
    errors = np.array([zone_errors(n, element, steps) for n in sizes])
    last = errors[:, -1]
    assert np.all(last <= at_end), last
    assert max(errors[-1]) <= everywhere, errors[-1]
    assert np.mean(order(last)) > rate, order(last)


# ---- refined meshes ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "mesh",
    [square(2), annulus(1, curved=False), annulus(1), grid([1.0], [3]), grid([1.0] * 3, [1] * 3)],
)
@pytest.mark.parametrize("coarse, fine", [("P1", "P1"), ("P1", "P2"), ("P2", "P2")])
def test_functions_of_a_mesh_are_functions_of_the_refined_ones(mesh, coarse, fine):
    clamped = sorted(mesh.boundaries)[0]
    curved, differences = isinstance(mesh, skfem.MeshTri2), []
    for k in (1, 2) if curved else (1,):
        kind, finest = ("solid", 2) if mesh.dim() == 3 else ("antiplane", k + 1 if curved else 3)
        spaces = [
            Discretisation(mesh, clamped, kind=kind, element=e, refinements=r)
            for e, r in ((coarse, k), (fine, finest))
        ]
        bodies = [body(space, [Viscosity(1.0)]) for space in spaces]
        P = spaces[1].from_coarser(spaces[0])
        assert P.shape == (spaces[1].dim, spaces[0].dim)
        A, finer = (one.problem.A for one in bodies)
        # the energy of a function does not depend on the mesh it is written on
        difference = P.T @ finer @ P - A
        function = f"sin(x) * {'xyz'[mesh.dim() - 1]}"
        smooth = spaces[0].interpolate([function] * 3 if kind == "solid" else function)
        differences.append(abs(smooth @ difference @ smooth) / (smooth @ A @ smooth))
    if curved:  # but for the quadrature, of second order there
        assert differences[1] < differences[0] / 3 < 2e-3
    else:
        assert abs(difference).max() < 1e-13 * abs(A).max()


def test_refined_meshes_keep_their_names_and_their_curved_edges():
    mesh = annulus(2)
    effects = [Viscosity({"core": 1.0, "sleeve": 2.0}), Friction("outer", g=1.0)]
    scenes = [
        antiplane(mesh, clamped="inner", effects=effects, refinements=k, element="P2")
        for k in range(4)
    ]
    assert scenes[0].discretisation.mesh is mesh
    triangles = [scene.discretisation.mesh.nelements for scene in scenes]
    assert triangles == [72 * 4**k for k in range(4)]
    # parabolas through points of the circle: nothing is straightened, so that all have one length
    lengths = np.array([scene.contact.weight.sum() for scene in scenes])
    changes = np.abs(np.diff(lengths))
    assert changes[0] < 1e-3
    assert order(changes) == pytest.approx(4.0, abs=0.2)  # Simpson's rule, on one curve
    assert abs(lengths[-1] - 4 * np.pi) < 2e-3


# ---- meshes -------------------------------------------------------------------------------------


@pytest.mark.parametrize("curved", [False, True])
def test_a_gmsh_file_gives_back_the_mesh_and_its_names(tmp_path, curved):
    mesh = annulus(3, curved=curved)
    read = read_mesh(write_msh(tmp_path / "ring.msh", mesh))
    assert isinstance(read, skfem.MeshTri2) == curved
    effects = [Viscosity({"core": 1.0, "sleeve": 0.3}), Friction("outer", g=0.5)]
    for element in ("P1", "P2"):
        one, two = scenes = [
            antiplane(m, clamped="inner", element=element, effects=effects) for m in (mesh, read)
        ]
        v, w = (s.discretisation.interpolate("x**3 - y") for s in scenes)
        assert v @ one.problem.A @ v == pytest.approx(w @ two.problem.A @ w, rel=1e-13)
        assert_allclose(one.contact.points, two.contact.points, atol=1e-15)
        assert_allclose(one.contact.weight, two.contact.weight, rtol=1e-13)


DAMAGE = [
    ("2.2", "$Nodes\n24", "$Nodes\n9999999999"),
    ("2.2", "$Elements\n48", "$Elements\n9999999999"),
    ("2.2", "\n24 ", "\n99999999999 "),
    ("2.2_binary", "$Nodes\n24", "$Nodes\n9999999999"),
    ("4.1", "\n22 183 1 183\n", "\n9999999999 9999999999 1 9999999999\n"),
    ("4.1", "\n66 84 2 89 ", "\n66 84 3 89 "),  # a middle node of two edges
]
TWO = "2 1 2 1\n3 1 2 5\n2 2 2 1\n4 5 1 7\n"
QUAD = "2 1 3 1\n3 1 2 5 7\n"
MESHES = Path(__file__).parent / "data" / "gmsh"
SMALL = "two_triangles_4.1"  # curve 1 is in two groups, group 12 has no name, node 9 is nowhere


@pytest.mark.parametrize("version", ["2.2", "4.1"])
def test_binary_files_and_text_files_hold_the_same_mesh(version):
    text, binary = (read_mesh(MESHES / f"tube_{version}{kind}.msh") for kind in ("", "_binary"))
    assert_allclose(text.doflocs, binary.doflocs, rtol=0, atol=1e-17)  # 16 digits
    assert np.array_equal(text.t, binary.t)
    for kind in ("boundaries", "subdomains"):
        groups, others = getattr(text, kind), getattr(binary, kind)
        assert len(groups) == len(others) >= 2
        assert all(np.array_equal(groups[name], others[name]) for name in groups)


def test_a_gmsh_41_file_with_sparse_tags_and_shared_groups():
    mesh = read_mesh(MESHES / f"{SMALL}.msh")
    assert (mesh.nvertices, mesh.nelements) == (4, 2)
    found = {name: len(edges) for name, edges in mesh.boundaries.items()}
    assert found == {"foot": 1, "all": 1, "12": 1}
    scene = antiplane(mesh, clamped="foot", effects=[Viscosity({"lower": 1.0, "upper": 2.0})])
    assert_allclose(scene.problem.A.toarray(), [[1.5, -1.0], [-1.0, 2.0]])


def corrupt(*changes, name=SMALL):
    """The file of that name with each (old, new) replaced."""
    content = (MESHES / f"{name}.msh").read_bytes()
    for old, new in changes:
        assert old.encode() in content
        content = content.replace(old.encode(), new.encode(), 1)
    return content


NODES = "*NODE\n1, 0, 0\n2, 1, 0\n3, 2, 0\n4, 0, 1\n** above\n5, 1, 1\n6, 2, 1\n"
BLOCKS = """*ELEMENT, TYPE=T3D2, ELSET=bottom
1, 1, 2
2, 2, 3
*ELEMENT, TYPE=T3D2, ELSET=roof
3, 4, 5
** behind this comment meshio reads on
4, 5, 6
*ELEMENT, TYPE=CPS3, ELSET=left half
5, 1, 2, 5
6, 1,
5, 4
*ELEMENT, TYPE=CPS3, ELSET=right half
7, 2, 3, 6
8, 2, 6, 5
"""
SETS = """*ELSET, ELSET=top, generate
3, 4, 1
*ELSET, ELSET=core
5, 6
*NSET, NSET=left
1, 4
*NSET, NSET=left and a corner
1, 4, 6
"""


def test_an_abaqus_file_has_its_sets_or_is_refused(tmp_path):
    """meshio gave the name "top" to the bottom where the first elements have no set."""
    path = tmp_path / "plate.INP"
    path.write_text(NODES + BLOCKS + SETS)
    mesh = read_mesh(path)
    lines = {"bottom": 1, "roof": 1, "top": 1, "left": 0}
    assert set(mesh.boundaries) == set(lines)  # no set that holds a node beside its edges
    for name, k in lines.items():
        places = mesh.p[k, mesh.facets[:, mesh.boundaries[name]]]
        assert set(places.ravel()) == {float(name in ("top", "roof"))}
    assert set(mesh.subdomains) == {"core", "left half", "right half"}
    assert mesh.p[0, mesh.t[:, mesh.subdomains["core"]]].max() == 1.0
    # what makes no node and no element is no fault
    more = "*ORIENTATION, SYSTEM=CYLINDRICAL\n0, 0, 0, 0, 0, 1\n*AMPLITUDE, INPUT=load.csv\n"
    path.write_text(NODES + BLOCKS + SETS + more)
    assert set(read_mesh(path).boundaries) == set(lines)
    for text, fault in (
        (NODES + SETS, "has no triangles"),
        (NODES + BLOCKS + SETS + NODES, "several blocks of nodes"),
        (NODES + BLOCKS + "*INSTANCE\n1.0, 0.0\n", "a keyword makes or moves"),
        (NODES + BLOCKS + "*NMAP\n", "a keyword makes or moves"),
        (NODES.replace("*NODE", "*NODE, SYSTEM=C") + BLOCKS, "a keyword makes or moves"),
        (NODES + BLOCKS + "*ELEMENT, TYPE=CPS3, INPUT=more.inp\n", "a keyword makes or moves"),
        (NODES + BLOCKS.replace(", ELSET=bottom", ""), "others without one"),
        (NODES + SETS + BLOCKS, "elements behind sets"),
        (NODES + BLOCKS + SETS + "*Nset, nset=LEFT\n2\n", "in several places"),
        (NODES + BLOCKS.replace("roof", "Bottom") + SETS, "in several places"),
        (NODES + BLOCKS + SETS + "*ELSET, ELSET=ends\nbottom, top\n", "sets of sets"),
        (NODES + BLOCKS + "*NSET, NSET=left,\nGENERATE\n1, 4, 3\n", "sets of sets"),
        (NODES.replace("4, 0, 1", "4, , 1") + BLOCKS, "could not convert"),
    ):
        path.write_text(text)
        with refuses(fault):
            read_mesh(path)


def test_groups_of_gmsh_41_without_a_name_or_turned_round(tmp_path):
    """meshio kept the first number of an entity, and no name of one that is negative."""
    path = tmp_path / "square.msh"
    path.write_bytes(corrupt((" 2 10 11 0", " 3 10 11 13 0"), (" 1 12 0", " 3 -11 13 12 0")))
    found = {name: len(edges) for name, edges in read_mesh(path).boundaries.items()}
    assert found == {"foot": 1, "all": 2, "13": 2, "12": 1}


def curve(mesh, move):
    """The bottom edges bent: `move` turns their first and second ends into their middles."""
    curved, bottom = skfem.MeshTri2.from_mesh(mesh), mesh.boundaries["bottom"]
    points = curved.doflocs.copy()
    ends = (mesh.p[:, ends] for ends in mesh.facets[:, bottom])
    points[:, curved.dofs.facet_dofs[0, bottom]] = move(*ends)
    return replace(curved, doflocs=points)


def flip(mesh):
    """A mesh whose inner node has been dragged out of its cell."""
    points = mesh.p.copy()
    points[:, np.argmin(np.hypot(*(points - 0.5)))] = [1.2, 0.5]
    return replace(mesh, doflocs=points)


DAMAGED = "is damaged or no mesh that meshio can read"
BAD_FILES = [
    (None, "cannot be read"),
    (b"", DAMAGED),
    (b"solid cube\n", DAMAGED),
    (b"$MeshFormat\n4.1 0 8\n$EndElements\n", DAMAGED),
    (b"$MeshFormat$EndElements", "is damaged"),
    (corrupt()[:-20], "is cut short"),
    (corrupt(("4 4 1 4", "5 4 1 4")), "is damaged"),
    (corrupt(("4.1 0 8", "9.9 0 8")), "is damaged .*Need mesh format in"),
    (corrupt(("0 1 2\n", "0 one 2\n")), "is damaged .*could not be read"),
    (corrupt(("0 1 2\n", "0 nan 2\n")), r"nodes\[\d, 1\] is nan; give finite coordinates"),
    (corrupt((" 2 10 11 0", " 0 0")), "has elements in no physical group"),
    (corrupt(("0 1 2\n", "0 1 3\n")), "is not flat"),
    (corrupt(("0 1 2\n", "0 0 2\n")), "triangle 1 near .* has no area"),
    (corrupt(("0 1 2\n", "0 1e-11 2\n")), "triangle 1 near .* has no area"),  # rounding
    (corrupt(("0 1 2\n", "0.9 0.1 2\n")), "triangle . near .* overlaps a neighbour"),
    (corrupt(("3 1 2 5", "3 1 2 8")), "is damaged: an element names a node that is not"),
    (corrupt(("1 2 1 1\n2 5 7", "1 2 1 1\n2 2 7")), "physical curve '12' has"),
    (corrupt(("4 4 1 4", "3 3 1 3"), (TWO, QUAD)), "only triangles of .* supported, not quad"),
    (corrupt(("4 4 1 4", "2 2 1 2"), (TWO, "")), "has no triangles"),
    (flip(square(2)), "triangle .* overlaps a neighbour"),
    # pulled through the body; at a quarter, where a corner has no area left
    (curve(square(2), lambda a, b: (a + b) / 2 + [[0], [0.6]]), ".* its curved edges cross"),
    (curve(square(2), lambda a, b: 0.75 * a + 0.25 * b), ".* its curved edges cross"),
    *((corrupt(one, name=f"tube_{name}"), "is damaged") for name, *one in DAMAGE),
    (corrupt(("free", "pulled"), name="tube_2.2"), "has physical groups of one name"),
    (corrupt(("free", "core"), name="tube_4.1_binary"), "has physical groups of one name"),
]


@pytest.mark.parametrize("content, message", BAD_FILES)
def test_a_bad_mesh_file_is_refused_with_its_name_and_fault(tmp_path, capfd, content, message):
    path = tmp_path / "bad.msh"
    if isinstance(content, skfem.MeshTri):
        write_msh(path, content)
    elif content is not None:
        path.write_bytes(content)
    with refuses(f"bad.msh: {message}"):
        read_mesh(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("d", [1, 2, 3])
def test_cells_that_are_there_twice_or_fold_over_are_refused(d):
    """As Gmsh writes those of two physical groups; intervals and tetrahedra counted twice."""
    mesh = grid([1.0] * d, [2] * d)
    twice = type(mesh)(mesh.p, np.hstack([mesh.t, mesh.t[:, :1]]))
    folded = grid([1.0] * d, [2] * d, ["x * (x - 0.7)", "y", "z"][:d])
    for one in (twice, folded):
        with refuses(r" \d near .* overlaps a neighbour or is there twice"):
            check_mesh(one)
    check_mesh(mesh)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_a_refined_mesh_keeps_its_names(d):
    """Those of solids were lost."""
    sizes = [1.0, 2.0, 1.5][:d]
    mesh = grid(sizes, [2, 1, 2][:d]).with_subdomains({"half": lambda x: x[0] < 0.5})
    fine = refined(mesh, 2)
    assert len(fine.subdomains["half"]) * 2 == fine.nelements == 4**d * mesh.nelements
    for name, facets in mesh.boundaries.items():
        plane = mesh.p[:, mesh.facets[:, facets]]
        k = int(np.ptp(plane, axis=(1, 2)).argmin())
        on = (fine.p[k, fine.facets] == plane[k, 0, 0]).all(axis=0)
        assert_array_equal(fine.boundaries[name], np.flatnonzero(on))


def pieces():
    """Two squares side by side, apart; only the left one touches x = 0."""
    left = square(2)
    mesh = skfem.MeshTri(
        np.hstack([left.p, np.add(left.p, [[2.0], [0.0]])]),
        np.hstack([left.t, left.t + left.nvertices]),
    )
    return mesh.with_boundaries({"left": lambda x: np.isclose(x[0], 0.0)})


VISCOUS = [Viscosity(1.0)]


def antiplane_square(**arguments):
    """A square, clamped on top, and viscous where `effects` says no more."""
    given = {"mesh": square(2), "clamped": "top", "effects": VISCOUS} | arguments
    return antiplane(given.pop("mesh"), **given)


def with_effect(effect, **arguments):
    return antiplane_square(effects=[*VISCOUS, effect], **arguments)


def with_eta(eta):
    """A ring in which every triangle is in two groups."""
    mesh = RING.with_subdomains({"all": np.arange(RING.nelements)})
    return antiplane(mesh, clamped="inner", effects=[Viscosity(eta)])


def interpolated(function):
    return antiplane_square().discretisation.interpolate(function)


RING = annulus(2)
INSIDE = square(2).with_boundaries({"cut": lambda x: x[0] == 0.5}, boundaries_only=False)
HALF = square(2).with_subdomains({"a": [0, 1]})
NOWHERE = square(2).with_boundaries({"gap": np.arange(0)}).with_subdomains({"hole": np.arange(0)})


def test_two_middle_nodes_of_one_edge_are_refused(tmp_path):
    corners, middles = [[0, 0], [1, 0], [1, 1], [0, 1]], [[0.5, 0], [1, 0.5], [0.5, 0.5]]
    points = np.pad([*corners, *middles, [0.5, 1], [0, 0.5], [0.5, 0.52]], ((0, 0), (0, 1)))
    mesh = meshio.Mesh(points, {"triangle6": [[0, 1, 2, 4, 5, 6], [0, 2, 3, 9, 7, 8]]})
    meshio.write(tmp_path / "square.vtk", mesh)
    with refuses("have not one middle node each"):
        read_mesh(tmp_path / "square.vtk")


def test_an_effect_finds_the_facets_of_one_boundary_or_of_several():
    """As on = "top" and on = ["top", "left"] of a scene file give them to an own effect."""
    body = antiplane_square(clamped="bottom").discretisation
    one, of_each = body.facets("on", "top")
    assert_array_equal(one, np.sort(body.mesh.boundaries["top"]))
    assert of_each["top"].tolist() == list(range(one.size))
    both, of_each = body.facets("on", ["top", "left"])
    assert set(both[of_each["top"]]) == set(one)
    assert set(both) > set(one)
