"""Every mutated file gives data or one LieidError: no other exception, crash, hang or bomb."""

import pytest
from fuzz.formats import FORMATS
from fuzz.supervisor import LoadingProcess, fuzz

SHORT, LONG = 80, 400


@pytest.fixture(scope="module")
def child():
    with LoadingProcess() as made:
        yield made


def report(tally):
    return "\n".join(
        f"{len(found)} × {group}; {found[0]}" for group, found in tally.groups().items()
    )


@pytest.mark.parametrize("name", FORMATS)
def test_mutated_files_give_data_or_an_error(name, child):
    tally = fuzz(FORMATS[name], range(SHORT), 0, child)
    assert tally.counts["data"] + tally.counts["refused"] == SHORT, report(tally)
    assert tally.counts["refused"] > SHORT // 10  # the mutations do damage


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_many_mutated_files_give_data_or_an_error(name, child):
    count = LONG // 2 if name == "episodes" else LONG  # some of the others end at the limit
    tally = fuzz(FORMATS[name], range(count), 1, child)
    hangs = [e for e in tally.escapes if e.detail.startswith("hang")]
    # pyarrow decodes some damaged column offsets for ever, and ends the process if asked for them
    assert len(hangs) <= (count // 200 if name == "episodes" else 0), report(tally)
    assert len(hangs) == len(tally.escapes), report(tally)


@pytest.mark.parametrize("name", FORMATS)
def test_a_mutation_is_reproducible(name):
    made = FORMATS[name]
    assert [made.mutation(k, 5) for k in range(8)] == [made.mutation(k, 5) for k in range(8)]
