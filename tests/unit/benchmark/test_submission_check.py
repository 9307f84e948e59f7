"""The checker of submissions: what it accepts, what it refuses and in which words, and that nothing breaks it."""

import dataclasses
import datetime as dt
import gzip
import math
import os
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.judge.answers import check_answer
from benchmark.protocol import Answer
from benchmark.submit import cells as submission_cells
from benchmark.submit import parquet_guard, submission
from benchmark.submit.csv_cells import csv_lines, safe_cell
from benchmark.submit.submission import FRAME_COLUMNS, check_answers, check_stars

HEADER = ",".join(FRAME_COLUMNS)
GOOD = "frame-00001,fix,52.1,4.5,0.01,0.001,0.02,0.9,12.5"
A_TIME = "expected above 0, at most 1e+09, or nothing where the time was not measured"


def problems_of(path, text, frame_ids=None, check=check_answers):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return [str(problem) for problem in check(path, frame_ids).problems]


@pytest.fixture
def file(tmp_path):
    return tmp_path / "answers.csv"


def test_a_submission_in_order(file):
    text = f"{HEADER}\n{GOOD}\nframe-00002,refused,,,,,,,3\r\nframe-00003,fix,-90,-180,,,,,\n"
    assert problems_of(file, text, {"frame-00001", "frame-00002", "frame-00003"}) == []
    first, second, third = check_answers(file).answers
    assert (first.lat_deg, first.lon_deg, first.cov_km2) == (52.1, 4.5, (0.01, 0.001, 0.02))
    assert (first.confidence, first.time_ms, second.status, second.lat_deg) == (0.9, 12.5, "refused", None)
    assert (third.cov_km2, third.confidence, third.time_ms) == (None, None, None)


def test_columns_may_come_in_any_order_and_optional_ones_be_left_out(file):
    assert problems_of(file, "\ufefflon_deg, status ,frame_id,lat_deg\n4.5,fix,frame-00001,52.1\n") == []
    assert check_answers(file).answers[0].lat_deg == 52.1


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("frame-00001,fix,91,0,,,,,", "line 2: lat_deg: found 91, expected -90 to 90"),
        ("frame-00001,fix,nan,0,,,,,", "line 2: lat_deg: found 'nan', expected a finite decimal number"),
        ("frame-00001,fix,1e999,0,,,,,", "line 2: lat_deg: found '1e999', expected a finite decimal number"),
        ("frame-00001,fix,-Infinity,0,,,,,", "line 2: lat_deg: found '-Infinity', expected a finite decimal number"),
        ("frame-00001,fix,1_0,0,,,,,", "line 2: lat_deg: found '1_0', expected a finite decimal number"),
        ("frame-00001,fix,٣,0,,,,,", "line 2: lat_deg: found '\\u0663', expected a finite decimal number"),
        ("frame-00001,fix,,0,,,,,", "line 2: lat_deg: is empty, expected a number"),
        ("frame-00001,refused,1,,,,,,", "line 2: lat_deg: a frame of status refused has no position; leave it empty"),
        ("frame-00001,ok,1,1,,,,,", "line 2: status: found 'ok', expected fix, refused, error"),
        ("frame-00001,fix,1,1,1,,1,,", "line 2: cov_ee: give cov_ee, cov_en and cov_nn together, or none of them"),
        ("frame-00001,fix,1,1,1,2,1,,", "line 2: cov_en: no covariance has cov_en^2 above cov_ee cov_nn"),
        ("frame-00001,fix,1,1,-1,0,1,,", "line 2: cov_ee: found -1, expected 0 to 1e+12"),
        ("frame-00001,fix,1,1,,,,1.5,", "line 2: confidence: found 1.5, expected 0 to 1"),
        ("frame-00001,fix,1,1,,,,,-1", f"line 2: time_ms: found -1, {A_TIME}"),
        ("frame-00001,fix,1,1,,,,,0", f"line 2: time_ms: found 0, {A_TIME}"),
        ("frame-00001,refused,,,,,,,0.0", f"line 2: time_ms: found 0, {A_TIME}"),
        ("frame-00001,fix,1,1,,,,,2e9", f"line 2: time_ms: found 2e+09, {A_TIME}"),
        ("frame-00001,fix,1", "line 2: has 3 cells, the header 9"),
        ('frame-00001,"fix,1,1,,,,,', "line 2: is not a line of CSV: a quote is not closed, or a character is not allowed"),
        ("a" * 5000, "line 2: has 5000 bytes, more than 4096"),
        ("a" * 300 + ",fix,1,1,,,,,", "line 2: has a cell of more than 200 characters, or a zero byte"),
    ],
)  # fmt: skip
def test_each_fault_is_named_with_line_column_and_reason(file, line, expected):
    assert expected in problems_of(file, f"{HEADER}\n{line}\n")


def test_a_variance_that_is_refused_is_given_all_the_same(file):
    found = problems_of(file, f"{HEADER}\nframe-00001,fix,1,1,-1,0,1,,\n")
    assert found == ["line 2: cov_ee: found -1, expected 0 to 1e+12"]


def test_numbers_as_other_programs_print_them(file):
    """C's %.34f, and pandas' integers of a column with gaps."""
    assert problems_of(file, f"{HEADER}\nframe-00001,fix,52.{'1' * 34},4.5,,,,,\n") == []
    rows = "frame_id,u_px,v_px,star_id\nframe-00001,1.0,2.0,3.0\nframe-00001,3.0,2.0,\n"
    assert problems_of(file, rows, check=check_stars) == []
    assert [row.star_id for row in check_stars(file).stars["frame-00001"]] == [3, None]
    assert len(problems_of(file, rows.replace("3.0\nf", "3.5\nf"), check=check_stars)) == 1


@pytest.mark.parametrize("cov", [[[-1.0, 0.0], [0.0, 1.0]], [[1.0, 5.0], [5.0, 1.0]]])
def test_a_program_s_impossible_covariance_is_refused_as_a_submitted_one_is(cov):
    answer = Answer(ok=True, reason="", lat_deg=1.0, lon_deg=1.0, cov_km2=np.array(cov))
    with pytest.raises(ValueError, match="covariance has"):
        check_answer(answer, 0)
    check_answer(dataclasses.replace(answer, cov_km2=np.array([[1.0, 1.0], [1.0, 1.0]])), 0)


@pytest.mark.parametrize(
    "name", ["=1+1", "+cmd|' /C calc'!A0", "-2", "@SUM(A1)", "../../etc/passwd", "/etc/passwd", "a/b", "a\\b",
             "<script>alert(1)</script>", "a b", "", "x" * 101, "\u202efdp"],
)  # fmt: skip
def test_an_id_is_no_formula_no_path_no_script(file, name):
    quoted = '"' + name.replace('"', '""') + '"'
    (problem,) = problems_of(file, f"{HEADER}\n{quoted},fix,1,1,,,,,\n")
    assert problem.startswith("line 2: frame_id: found ")
    assert problem.isascii()
    assert problem.isprintable()
    assert check_answers(file).answers == ()


def test_duplicates_strangers_and_missing_frames(file):
    found = problems_of(file, f"{HEADER}\n{GOOD}\n{GOOD}\nframe-9,refused,,,,,,,\n", {"frame-00001", "frame-00002"})
    assert found == [
        "frame_id: frame-00002 is missing; give it the status refused where there is no answer",
        "line 3: frame_id: frame-00001 was answered on line 2; answer each frame once",
        "line 4: frame_id: frame-9 is not a frame of this set",
    ]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "is empty"),
        (b"\n\n", f"line 1: expected the header {HEADER}"),
        (gzip.compress(HEADER.encode(), mtime=0), "is compressed (gzip); send the CSV or Parquet file itself"),
        (b"\x28\xb5\x2f\xfd0000", "is compressed (zstd); send the CSV or Parquet file itself"),
        (b"frame_id,status,lat_deg\n", "line 1: lon_deg: column is missing"),
        (b"frame_id,status,lat_deg,lon_deg,password\n", "line 1: column 5 has no known name: found 'password'"),
        (b"frame_id,status,lat_deg,lon_deg,lat_deg\n", "line 1: lat_deg: is there twice"),
        (b"frame_id,status,lat_deg,lon_deg\n\xff,fix,1,1\n", "line 2: is not UTF-8 text; save the file as UTF-8"),
        (HEADER.encode("utf-16"), "is UTF-16 text; save it as UTF-8"),
        (f"{HEADER}\r{GOOD}\r".encode(), "ends its lines with carriage returns alone"),
        (b"PAR1 not really PAR1", "is damaged, or needs more memory or time than its content may take"),
    ],
)
def test_files_that_are_no_tables(file, content, expected):
    assert any(problem.startswith(expected) for problem in problems_of(file, content))
    assert check_answers(file).answers == ()


@pytest.mark.parametrize(("character", "word"), [(";", "semicolons"), ("\t", "tabs"), ("|", "bars")])
def test_cells_that_a_spreadsheet_separated_otherwise(file, character, word):
    text = f"{HEADER}\n{GOOD}\n".replace(",", character)
    expected = f"line 1: cells are separated by {word}; separate them by commas, and write 1.5, not 1,5"
    assert problems_of(file, text) == [expected]
    assert problems_of(file, text.replace(".", ",")) == [expected]


@pytest.mark.parametrize("header", [HEADER.upper(), GOOD, '{"a": 1}'])
def test_a_first_line_without_any_known_name_is_one_problem(file, header):
    (problem,) = problems_of(file, f"{header}\n{GOOD}\n")
    assert problem.startswith("line 1: is no header: found '")
    assert problem.endswith(f"expected {HEADER}")


def test_a_zip_bomb_is_not_opened(file):
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("answers.csv", b"\0" * 10_000_000)
    assert problems_of(file, file.read_bytes()) == ["is compressed (zip); send the CSV or Parquet file itself"]


def test_links_pipes_and_folders_are_not_read(file, tmp_path):
    secret = tmp_path / "secret.csv"
    secret.write_text(f"{HEADER}\n{GOOD}\n")
    file.symlink_to(secret)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path, expected in (
        (file, "is a link; give the file itself"),
        (pipe, "is a pipe or a device; give a CSV or Parquet file"),
        (tmp_path, "is a folder; give a CSV or Parquet file"),
        (tmp_path / "missing", "cannot be opened (No such file or directory)"),
    ):
        checked = check_answers(path)
        assert [str(problem) for problem in checked.problems] == [expected]
        assert checked.answers == ()


def test_limits_of_size(file, monkeypatch):
    monkeypatch.setattr(submission, "LARGEST_FRAMES", 2)
    lines = "\n".join(f"frame-{i},refused,,,,,,," for i in range(4))
    assert problems_of(file, f"{HEADER}\n{lines}\n") == ["line 4: more than 2 rows; the rest is not read"]
    assert len(check_answers(file).answers) == 2
    assert problems_of(file, HEADER + "\n" * 1100) == ["has more than 1002 lines"]
    monkeypatch.setattr(submission_cells, "LARGEST_FILE_BYTES", 50)
    assert problems_of(file, f"{HEADER}\n{lines}\n")[0].endswith(
        "bytes, more than 50; Parquet files are smaller than CSV"
    )


def test_only_so_many_problems_are_kept(file):
    found = problems_of(file, HEADER + "\n" + "x,y,z\n" * 1500)
    assert len(found) == submission.MAX_PROBLEMS + 1
    assert "and 500 more problems" in found[-1]


def test_a_star_table(file):
    text = "frame_id,u_px,v_px,star_id\nframe-1,10.5,20,677\nframe-1,1,2,\nframe-2,nan,2,5\nframe-2,1,2,99999999999\n"
    assert problems_of(file, text, check=check_stars) == [
        "line 4: u_px: found 'nan', expected a finite decimal number",
        "line 5: star_id: found '99999999999', expected an integer of 32 bits, or nothing",
    ]
    assert [row.star_id for row in check_stars(file).stars["frame-1"]] == [677, None]


ANSWERS = {
    "frame_id": ["frame-1", "frame-2"],
    "status": ["fix", "refused"],
    "lat_deg": [1.5, None],
    "lon_deg": [2.5, None],
    "confidence": [0.5, None],
    "time_ms": [3, 4],
}


@pytest.mark.parametrize("compression", ["snappy", "zstd", "gzip", "none"])
def test_parquet(file, compression):
    pq.write_table(pa.table(ANSWERS), file, compression=compression)
    checked = check_answers(file, {"frame-1", "frame-2"})
    assert checked.problems == ()
    assert [(answer.lat_deg, answer.time_ms) for answer in checked.answers] == [(1.5, 3.0), (None, 4.0)]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"lat_deg": [math.nan, None]}, "line 1: lat_deg: found nan, expected a finite decimal number"),
        ({"lat_deg": [math.inf, None]}, "line 1: lat_deg: found inf, expected a finite decimal number"),
        ({"frame_id": ["frame-1", "=cmd()"]}, "line 2: frame_id: found '=cmd()', expected letters"),
        ({"frame_id": ["frame-1", "frame-1"]}, "line 2: frame_id: frame-1 was answered on line 1"),
        ({"status": [1, 2]}, "line 1: status: found 1, expected fix"),
        ({"lat_deg": [[1.0], [2.0]]}, "column 3 is nested or of a type other than text, integer or float"),
        ({"lat_deg": [{"a": 1}, {"a": 2}]}, "column 3 is nested or of a type other than text, integer or float"),
        ({"lat_deg": [True, False]}, "column 3 is nested or of a type other than text, integer or float"),
        ({"lat_deg": [dt.date(2020, 1, 1), None]}, "column 3 is nested or of a type"),
        ({"extra": [1, 2]}, "line 1: column 7 has no known name"),
        ({"frame_id": ["x" * 5000, "y"]}, "has a text of 5000 bytes, more than 800"),
        ({f"c{i}": [0, 0] for i in range(40)}, "has more than 32 columns or 10000 row groups"),
    ],
)
def test_parquet_faults(file, change, expected):
    pq.write_table(pa.table({**ANSWERS, **change}), file)
    assert any(str(problem).startswith(expected) for problem in check_answers(file).problems)


def test_parquet_bombs(file):
    """Few bytes that stand for many: rows beyond the limit, and a page that unpacks to gigabytes."""
    n = submission.LARGEST_FRAMES + 1
    pq.write_table(pa.table({**{name: pa.nulls(n, pa.string()) for name in FRAME_COLUMNS}}), file)
    assert file.stat().st_size < 10_000
    assert problems_of(file, file.read_bytes()) == [f"has {n} rows, more than {n - 1}"]
    long = "x" * 2_000_000
    pq.write_table(pa.table({**ANSWERS, "status": [long, long]}), file, compression="zstd", use_dictionary=False)
    assert file.stat().st_size < 50_000
    assert problems_of(file, file.read_bytes()) == ["has a text of 2000000 bytes, more than 800"]
    dictionary = pa.DictionaryArray.from_arrays(pa.array([0] * 150_000, pa.int32()), [long])
    table = pa.table({"frame_id": dictionary, "status": dictionary, "lat_deg": pa.nulls(150_000, pa.float64())})
    pq.write_table(table, file, compression="zstd")
    assert file.stat().st_size < 100_000  # 600 GB of text
    (problem,) = problems_of(file, file.read_bytes())
    assert problem.startswith(("is damaged, or needs more memory", "has a text of"))


def test_an_extension_type_is_not_revived(file):
    """A type that names Python code to load is data like any other: refused or read as what it stores."""

    class Evil(pa.ExtensionType):
        def __init__(self):
            super().__init__(pa.string(), "skybench.evil")

        def __arrow_ext_serialize__(self):
            return b"cos\nsystem\n(S'touch /tmp/owned'\ntR."

        @classmethod
        def __arrow_ext_deserialize__(cls, storage, serialized):
            raise AssertionError("revived")

    table = pa.table({**ANSWERS, "status": pa.ExtensionArray.from_storage(Evil(), pa.array(["fix", "refused"]))})
    pq.write_table(table, file)
    assert len(check_answers(file).answers) == 2


def test_a_reader_that_crashes_or_hangs_is_contained(monkeypatch):
    monkeypatch.setattr(parquet_guard, "_CHILD", "import os; os.abort()")
    with pytest.raises(parquet_guard.GuardError, match="damaged"):
        parquet_guard.read_guarded(b"PAR1", 1, 1)
    monkeypatch.setattr(parquet_guard, "CPU_SECONDS", 0.25)
    monkeypatch.setattr(parquet_guard, "_CHILD", "import time; time.sleep(60)")
    with pytest.raises(parquet_guard.GuardError, match="longer than"):
        parquet_guard.read_guarded(b"PAR1", 1, 1)


CELLS = st.one_of(
    st.text(max_size=30),
    st.sampled_from(["frame-1", "fix", "refused", "1.5", "-0", "1e5", "nan", "=A1", '"', "\r", "\0", "٣"]),
)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(rows=st.lists(st.lists(CELLS, max_size=11), max_size=6), header=st.booleans())
def test_whatever_the_text_the_checker_answers_in_plain_words(tmp_path, rows, header):
    path = tmp_path / "fuzz.csv"
    body = "\n".join(",".join(row) for row in rows)
    path.write_bytes(((HEADER + "\n" if header else "") + body).encode("utf-8", "surrogatepass"))
    for check in (check_answers, check_stars):
        checked = check(path, {"frame-1"})
        assert all(str(problem).isascii() and str(problem).isprintable() for problem in checked.problems)
        for answer in checked.answers:
            assert answer.frame_id == "frame-1"
            assert answer.status in submission.STATUSES
            assert (answer.lat_deg is not None and abs(answer.lat_deg) <= 90) == (answer.status == "fix")


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(content=st.binary(max_size=400))
def test_whatever_the_bytes_the_checker_does_not_fall(tmp_path, content):
    path = tmp_path / "fuzz.bin"
    path.write_bytes(content if not content.startswith(b"PAR1") else b"x" + content)
    assert check_answers(path, {"frame-1"}).answers == ()


@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(place=st.integers(4, 1500), value=st.integers(0, 255))
def test_a_damaged_parquet_file_is_a_problem_or_harmless(tmp_path, place, value):
    path = tmp_path / "fuzz.parquet"
    pq.write_table(pa.table(ANSWERS), path)
    content = bytearray(path.read_bytes())
    content[place % len(content)] = value
    path.write_bytes(bytes(content))
    checked = check_answers(path, {"frame-1", "frame-2"})
    assert checked.problems or len(checked.answers) == 2


def test_what_is_written_is_no_formula():
    assert [safe_cell(text) for text in ("=1+1", "+1", "-1", "@a", "\tx", "plain")] == [
        "'=1+1", "'+1", "'-1", "'@a", "'\tx", "plain"
    ]  # fmt: skip
    assert csv_lines([("a", -1.5), ("=HYPERLINK(1)", 2)]) == "a,-1.5\n'=HYPERLINK(1),2\n"


def test_the_command_says_line_by_line_what_is_wrong(file):
    file.write_text(f"{HEADER}\nframe-1,fix,95,1,,,,,\n", encoding="utf-8")
    run = CliRunner().invoke(app, ["bench", "check", str(file)])
    assert run.exit_code == 1
    assert f"{file}: line 2: lat_deg: found 95, expected -90 to 90" in run.output
    file.write_text(f"{HEADER}\n{GOOD}\n", encoding="utf-8")
    run = CliRunner().invoke(app, ["bench", "check", str(file)])
    hint = "; with --set SET, ids and missing frames are checked too"
    assert (run.exit_code, run.output) == (0, f"in order: 1 frames, 1 fixes{hint}\n")
    assert CliRunner().invoke(app, ["bench", "check", str(file), "--set", str(file.parent)]).exit_code == 2


def test_detections_of_a_frame_are_limited(file, monkeypatch):
    monkeypatch.setattr(submission, "LARGEST_DETECTIONS_OF_A_FRAME", 2)
    rows = "".join(f"{frame},{n}.5,2,677\n" for frame in ("frame-1", "frame-2") for n in range(2))
    file.write_text("frame_id,u_px,v_px,star_id\n" + rows)
    assert check_stars(file).problems == ()
    found = problems_of(file, "frame_id,u_px,v_px,star_id\n" + rows + "frame-1,9,9,\n", check=check_stars)
    assert found == ["line 6: frame-1 has more than 2 detections"]
    assert len(check_stars(file).stars["frame-1"]) == 2
