"""One dataset for all formats. Tests that change it copy it."""

import pytest
from simulated_dataset import write_dataset

from graycast.export import Options, Split, export


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("master") / "out"
    return out, write_dataset(out)


@pytest.fixture(scope="session")
def master(made):
    return made[0]


@pytest.fixture(scope="session")
def samples(made):
    return made[1]


@pytest.fixture
def exported(master, tmp_path):
    """Exports the dataset; keywords are options."""

    def run(form, **said):
        said.setdefault("split", Split())
        out = tmp_path / f"{form}-{len(list(tmp_path.iterdir()))}"
        export(master, out, Options(format=form, **said))
        return out

    return run
