"""Names are found where a user looks for them: `dir`, `help`, tab completion, `import *`."""

import pydoc
from inspect import signature

import pytest
from processes import python

import sweepopt as so


def fresh(code):
    """What a new Python prints."""
    return python(code).stdout.strip()


def test_importing_the_library_takes_no_time():
    """A fraction of what scipy.sparse takes, which every use of it needs."""
    code = "import time; t = time.process_time(); import {}; print(time.process_time() - t)"
    # the less of two: other processes slow one of them
    ours, theirs = (
        min(float(fresh(code.format(name))) for _ in range(2))
        for name in ("sweepopt", "scipy.sparse")
    )
    assert ours < min(0.3, theirs)


def test_dir_has_the_public_names_and_each_of_them_is_there():
    public = {name for name in dir(so) if not name.startswith("__")}
    assert public == {*so.__all__, "fem", "study", "plot"}
    for name in so.__all__:
        assert getattr(so, name).__name__ == name
        assert getattr(so, name).__module__.startswith("sweepopt")
    names = {}
    exec("from sweepopt import *", names)
    assert names["solve"] is so.solve
    with pytest.raises(AttributeError, match="no attribute 'solv'"):
        so.solv  # noqa: B018


def test_help_and_rooms_are_there_whatever_is_imported_before():
    code = "import sweepopt.driver, sweepopt as so; help(so.fem.read_scene); "
    shown, _, last = fresh(code + "print(so.solve, so.plot)").rpartition("\n")
    assert "function" in last
    assert "sweepopt.plot" in last
    assert "[effects.friction]" in shown
    lines = shown.partition("All effects")[2].splitlines()
    keys = {words[0]: words[1:] for line in lines if (words := line.split())}
    for name, effect in so.fem.EFFECTS.items():
        assert [key.strip("[],") for key in keys[name]] == list(signature(effect).parameters)
    assert "SweepingProcess" in pydoc.render_doc(so)


def test_missing_extras_are_named_and_leave_dir_and_help_alone():
    extras = {"fem": "skfem", "study": "plotly"}
    code = f"""if True:
        import sys, pydoc
        sys.modules |= dict.fromkeys({[*extras.values()]})
        import sweepopt as so
        from sweepopt.cli import main
        pydoc.render_doc(so)
        for extra in {[*extras]}:
            assert not hasattr(so, extra)
            try:
                getattr(so, extra)
            except AttributeError as error:
                print(error)
        main(["study", "mesh"])
    """
    shown = python(code)
    told = [*shown.stdout.splitlines(), shown.stderr.removeprefix("sweepopt: ")]
    for package, line in zip([*extras.values(), "plotly"], told, strict=True):
        assert line.startswith(f"{package} is not installed; run: ")


def test_scenes_are_listed_and_read_by_name():
    assert so.list_scenes()["tube"].startswith("Tube")
    scene = so.scene("pipe", changes={"time.steps": 3})
    assert scene.steps == 3
    assert {*signature(so.scene).parameters} == {*signature(so.fem.read_scene).parameters}
    with pytest.raises(so.InputError, match="tube"):
        so.scene("tub")


def test_a_solver_has_one_name_in_solve_in_scenes_and_in_studies():
    C = so.Moving(so.Ball([0.0, 0.0], 1.0), center=lambda t: [3.0 * t, t])
    process = so.SweepingProcess([[2.0, 1.0], [1.0, 2.0]], None, C, [0.0, 0.0])
    sol = so.solve(process, t_end=1.0, steps=2, solver="cvxpy:clarabel")
    assert set(sol.stats["solver"]) == {"cvxpy:clarabel"}
    assert so.scene("pipe", changes={"solve.solver": "cvxpy:scs"}).solver == "cvxpy:scs"


def test_every_error_and_warning_of_the_library_can_be_imported_from_it():
    kinds = {
        name
        for name, one in vars(so.errors).items()
        if isinstance(one, type) and issubclass(one, (so.SweepoptError, so.SweepoptWarning))
    }
    assert kinds - {"_Failure"} <= set(so.__all__)
