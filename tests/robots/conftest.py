import pytest
from arms import HOME_PANDA, MIXED, PANDA, UR5, UR10, arm_urdf

from regrasp_opt.robots import load_robot


@pytest.fixture(scope="session")
def nova2():
    return load_robot("nova2")


@pytest.fixture(scope="session")
def ur5():
    return load_robot(UR5)


@pytest.fixture(scope="session")
def panda():
    return load_robot(PANDA, tip="panda_link8", home=HOME_PANDA)


@pytest.fixture(scope="session")
def mixed(tmp_path_factory):
    path = tmp_path_factory.mktemp("mixed") / "arm.urdf"
    path.write_text(arm_urdf(MIXED))
    return load_robot(path)


@pytest.fixture(scope="session", params=["nova2", "ur5", "ur10", "panda", "mixed"])
def any_robot(request):
    return load_robot(UR10) if request.param == "ur10" else request.getfixturevalue(request.param)
