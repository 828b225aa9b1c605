"""Each reader on a small tree in the layout that the data set's authors publish."""

import os
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest

from mscf.errors import SourceError
from mscf.evaluation.datasets import Dataset, Skipped, dtb70, otb, read_dataset, read_sequence, uav123
from mscf.geometry import Box
from mscf.images import read_truth


def write_images(folder: Path, numbers: Iterable[int], name: str) -> None:
    """Images of one gray each, by which `number_of` knows them again."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        assert cv2.imwrite(str(folder / name.format(number)), np.full((8, 8, 3), 7 * number % 256, np.uint8))


def shows(dataset: Dataset, sequence: str, index: int, number: int) -> bool:
    """Whether frame `index` of a sequence is the image that was written with `number`."""
    image = next(s for s in dataset.sequences if s.name == sequence).read(index)
    return abs(float(image.mean()) - 7 * number % 256) < 3


def write_truth(path: Path, count: int, separator: str = ",", first: int = 1) -> tuple[Box, ...]:
    """Moving 1-based boxes; returned as they must be read."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [(10 + i, 20 + i, 30, 40) for i in range(first, first + count)]
    path.write_text("".join(separator.join(map(str, row)) + "\n" for row in rows))
    return tuple(Box(x - 1, y - 1, w, h) for x, y, w, h in rows)


def names(dataset: Dataset) -> list[str]:
    return [sequence.name for sequence in dataset.sequences]


# --- a file of boxes ---


def test_truth_may_be_separated_by_comma_tab_or_blank_and_absent(tmp_path: Path) -> None:
    path = tmp_path / "groundtruth.txt"
    path.write_text("1,2,3,4\n5\t6\t7\t8\n9 10 11 12\nNaN,NaN,NaN,NaN\n0,0,0,0\n5,5,0,7\n5,5,7,0\n\n2, 2, 2, 2\n\n")
    boxes = (Box(0, 1, 3, 4), Box(4, 5, 7, 8), Box(8, 9, 11, 12))
    assert read_truth(path) == (*boxes, *5 * [None], Box(1, 1, 2, 2))


@pytest.mark.parametrize("line", ["1,2,3", "1,2,3,4,5", "a,b,c,d", ","])
def test_a_line_that_is_no_box_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "groundtruth.txt"
    path.write_text(f"1,2,3,4\n{line}\n1,2,3,4\n")
    with pytest.raises(SourceError, match="line 2: expected x,y,w,h, got"):
        read_truth(path)


def test_a_file_of_boxes_that_is_missing_or_no_text_is_named(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"none\.txt cannot be read: No such file"):
        read_truth(tmp_path / "none.txt")
    (tmp_path / "bytes.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SourceError, match=r"bytes\.txt cannot be read: it is not text"):
        read_truth(tmp_path / "bytes.txt")


# --- the folder and the names ---


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """Two whole sequences in the plain layout."""
    for name, count in (("bay", 3), ("alp", 4)):
        write_images(tmp_path / "set" / name / "img", range(1, count + 1), "{:06d}.jpg")
        write_truth(tmp_path / "set" / name / "groundtruth.txt", count)
    return tmp_path / "set"


def test_the_plain_layout_is_read_by_name(plain: Path) -> None:
    dataset = read_dataset(plain)
    assert (dataset.name, names(dataset), dataset.skipped) == ("set", ["alp", "bay"], ())
    alp = dataset.sequences[0]
    assert [path.name for path in alp.images] == [f"{number:06d}.jpg" for number in range(1, 5)]
    assert alp.truth[0] == Box(10, 20, 30, 40)
    assert alp.attributes == frozenset()
    assert shows(dataset, "alp", 3, 4)
    assert alp == read_sequence(plain / "alp")


def test_only_the_named_sequences_are_read(plain: Path) -> None:
    (plain / "alp" / "groundtruth.txt").write_text("nonsense")
    dataset = read_dataset(plain, ["bay"])
    assert (names(dataset), dataset.skipped) == (["bay"], ())


def test_an_unknown_name_is_refused_with_the_nearest_valid_one(plain: Path) -> None:
    with pytest.raises(SourceError, match=r"no sequence 'bai' in .*: did you mean 'bay'") as caught:
        read_dataset(plain, ("alp", "bai"))
    assert "\n" not in str(caught.value)


def test_an_incomplete_sequence_is_skipped_with_its_reason_and_the_others_are_read(plain: Path) -> None:
    (plain / "alp" / "img" / "000003.jpg").unlink()
    write_images(plain / "no_truth" / "img", [1], "{}.jpg")
    write_truth(plain / "no_images" / "groundtruth.txt", 1)
    write_images(plain / "absent" / "img", [1], "{}.jpg")
    (plain / "absent" / "groundtruth.txt").write_text("nan,nan,nan,nan\n")
    (plain / "notes").mkdir()
    dataset = read_dataset(plain)
    assert names(dataset) == ["bay"]
    assert [(skipped.name, skipped.why.split("/")[-1]) for skipped in dataset.skipped] == [
        ("absent", "absent has no box in the first line of its ground truth"),
        ("alp", "alp has 3 images and 4 lines of ground truth"),
        ("no_images", "no_images is no sequence: expected groundtruth.txt and a folder img in it"),
        ("no_truth", "no_truth is no sequence: expected groundtruth.txt and a folder img in it"),
    ]


def test_where_nothing_is_whole_the_first_reason_is_told(plain: Path) -> None:
    for truth in plain.glob("*/groundtruth.txt"):
        truth.write_text("1,2,3,4\n")
    with pytest.raises(SourceError, match="no whole sequence, the first of 2: alp has 4 images and 1 lines"):
        read_dataset(plain)


def test_a_folder_of_another_layout_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "something").mkdir()
    with pytest.raises(SourceError, match="is no data set that can be read: expected in it NAME/img") as caught:
        read_dataset(tmp_path)
    assert "\n" not in str(caught.value)
    with pytest.raises(SourceError, match="is not a folder"):
        read_dataset(tmp_path / "none")


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is closed to root")
def test_a_folder_that_may_not_be_listed_is_a_reason_to_skip(plain: Path) -> None:
    (plain / "alp" / "img").chmod(0o000)
    dataset = read_dataset(plain)
    (plain / "alp" / "img").chmod(0o700)
    assert names(dataset) == ["bay"]
    assert "Permission denied" in dataset.skipped[0].why


def test_a_broken_image_is_found_when_it_is_read_and_names_itself(plain: Path) -> None:
    (plain / "alp" / "img" / "000002.jpg").write_bytes(b"broken")
    alp = read_dataset(plain).sequences[0]
    with pytest.raises(SourceError, match=r"000002\.jpg is not an image"):
        alp.read(1)


# --- UAV123 and UAV123@10fps ---


@pytest.mark.parametrize(("step", "frames"), [(1, 112_578), (3, 37_607)])
def test_the_clips_have_the_published_number_of_frames(step: int, frames: int) -> None:
    """123 clips; the sums are those of the data set's page."""
    clips = uav123.clips(step)
    assert len(clips) == 123
    assert sum(last - first + 1 for _, first, last in clips.values()) == frames


@pytest.mark.parametrize(
    ("clip", "expected"),  # of the authors' configSeqs.m for UAV123_10fps
    [
        ("bird1_1", ("bird1", 1, 85)),
        ("bird1_2", ("bird1", 259, 493)),
        ("car1_s", ("car1_s", 1, 492)),
        ("group3_4", ("group3", 1457, 1843)),
        ("person2_s", ("person2_s", 1, 84)),
        ("uav1_3", ("uav1", 825, 1157)),
        ("wakeboard10", ("wakeboard10", 1, 157)),
    ],
)
def test_the_frames_of_10fps_follow_from_those_of_30fps(clip: str, expected: tuple[str, int, int]) -> None:
    assert uav123.clips(3)[clip] == expected


@pytest.fixture
def uav(tmp_path: Path) -> Path:
    """UAV123@10fps with one folder of three clips and one of a single one."""
    images, boxes = (tmp_path / half / "UAV123_10fps" for half in ("data_seq", "anno"))
    write_images(images / "bird1", range(1, 814), "{:06d}.jpg")
    write_images(images / "uav6", range(1, 38), "{:06d}.jpg")
    write_images(images / "uav6", [0], "preview{}.jpg")  # no frame
    for clip, count in (("bird1_1", 85), ("bird1_2", 235), ("bird1_3", 289), ("uav6", 37)):
        write_truth(boxes / f"{clip}.txt", count)
    (boxes / "att").mkdir()
    (boxes / "att" / "bird1_2.txt").write_text("1,1,1,1,1,1,1,0,0,0,0,0\n")
    (boxes / "att" / "uav6.txt").write_text("1,0,1,1,1,1,0,0,0,0,1,1\n")
    return tmp_path


def test_a_clip_is_cut_from_its_folder_by_image_numbers(uav: Path) -> None:
    dataset = read_dataset(uav)
    assert (dataset.name, dataset.skipped) == ("UAV123@10fps", ())
    assert names(dataset) == ["bird1_1", "bird1_2", "bird1_3", "uav6"]
    ranges = [(s.images[0].stem, s.images[-1].stem, len(s.truth)) for s in dataset.sequences]
    assert ranges == [
        ("000001", "000085", 85),
        ("000259", "000493", 235),
        ("000525", "000813", 289),
        ("000001", "000037", 37),
    ]
    assert shows(dataset, "bird1_2", 0, 259)
    assert shows(dataset, "bird1_2", 234, 493)
    assert dataset.sequences[1].truth[0] == Box(10, 20, 30, 40)
    assert dataset.sequences[1].attributes == {"SV", "ARC", "LR", "FM", "FOC", "POC", "OV"}
    assert dataset.sequences[3].attributes == {"SV", "LR", "FM", "FOC", "POC", "CM", "SOB"}
    assert dataset.sequences[0].attributes == frozenset()  # its file is not there


def test_the_30fps_version_has_its_own_numbers_and_what_is_not_there_is_skipped(tmp_path: Path) -> None:
    images, boxes = (tmp_path / half / "UAV123" for half in ("data_seq", "anno"))
    write_images(images / "bird1", [*range(1, 254), *range(775, 1478)], "{:06d}.jpg")
    truth = [write_truth(boxes / f"bird1_{n}.txt", count) for n, count in ((1, 253), (2, 703), (3, 865))]
    dataset = read_dataset(tmp_path)
    assert (dataset.name, names(dataset)) == ("UAV123", ["bird1_1", "bird1_2"])
    assert dataset.sequences[1].images[0].stem == "000775"
    assert dataset.sequences[1].truth == truth[1]
    reason = f"{images / 'bird1'} lacks image 1573, 865 of its images 1573 to 2437 in all"
    assert dataset.skipped == (Skipped("bird1_3", reason),)


def test_the_target_of_uav123_is_absent_where_it_is_nan(uav: Path) -> None:
    path = uav / "anno" / "UAV123_10fps" / "uav6.txt"
    lines = path.read_text().splitlines()
    lines[4] = "NaN,NaN,NaN,NaN"
    path.write_text("\n".join(lines))
    truth = read_dataset(uav, ["uav6"]).sequences[0].truth
    assert [index for index, box in enumerate(truth) if box is None] == [4]


def test_a_clip_without_an_image_its_boxes_or_its_folder_is_skipped(uav: Path) -> None:
    (uav / "data_seq" / "UAV123_10fps" / "bird1" / "000300.jpg").unlink()
    (uav / "anno" / "UAV123_10fps" / "bird1_1.txt").unlink()
    write_truth(uav / "anno" / "UAV123_10fps" / "bird1_3.txt", 288)
    write_truth(uav / "anno" / "UAV123_10fps" / "uav5.txt", 47)
    dataset = read_dataset(uav)
    assert names(dataset) == ["uav6"]
    reasons = {skipped.name: skipped.why for skipped in dataset.skipped}
    assert reasons["bird1_1"].endswith("bird1_1.txt cannot be read: No such file or directory")
    assert reasons["bird1_2"].endswith("bird1 lacks image 300, 1 of its images 259 to 493 in all")
    assert reasons["bird1_3"] == "bird1_3 has 289 images and 288 lines of ground truth"
    assert reasons["uav5"].endswith("uav5, the folder of its images, is missing")


def test_a_wrong_number_of_flags_is_a_reason_to_skip(uav: Path) -> None:
    (uav / "anno" / "UAV123_10fps" / "att" / "bird1_1.txt").write_text("1,0\n")
    (uav / "anno" / "UAV123_10fps" / "att" / "bird1_2.txt").write_text("\n")
    assert [skipped.why.split("att/")[1] for skipped in read_dataset(uav).skipped] == [
        "bird1_1.txt, line 1: expected 12 flags, SV ARC LR FM FOC POC OV BC IV VC CM SOB, got '1,0'",
        "bird1_2.txt has no flags in its first line",
    ]


def test_of_two_versions_in_one_folder_the_meant_one_is_given(uav: Path) -> None:
    (uav / "data_seq" / "UAV123").mkdir()
    with pytest.raises(SourceError, match=r"holds two versions of UAV123: give .*UAV123_10fps or .*UAV123"):
        read_dataset(uav)
    assert len(read_dataset(uav / "data_seq" / "UAV123_10fps").sequences) == 4
    with pytest.raises(SourceError, match="anno/UAV123 is missing: UAV123 has its images in data_seq"):
        read_dataset(uav / "data_seq" / "UAV123")


# --- UAVDT ---


@pytest.fixture
def uavdt(tmp_path: Path) -> Path:
    boxes = tmp_path / "UAV-benchmark-SOT_v1.0" / "anno"
    for name, count in (("S0101", 3), ("S0310", 12)):
        write_images(tmp_path / "UAV-benchmark-S" / name, range(1, count + 1), "img{:06d}.jpg")
        write_truth(boxes / f"{name}_gt.txt", count)
    (boxes / "att").mkdir()
    (boxes / "att" / "S0101_att.txt").write_text("1,0,1,0,1,0,1,0,0\n")
    (boxes / "att" / "S0310_att.txt").write_text("1,1,0,0,0,1,1,0,1\n")
    return tmp_path


def test_uavdt_keeps_boxes_and_attributes_apart_from_the_images(uavdt: Path) -> None:
    dataset = read_dataset(uavdt)
    assert (dataset.name, names(dataset), dataset.skipped) == ("UAVDT", ["S0101", "S0310"], ())
    assert [path.name for path in dataset.sequences[0].images] == [f"img00000{number}.jpg" for number in (1, 2, 3)]
    assert dataset.sequences[1].truth[11] == Box(21, 31, 30, 40)
    assert shows(dataset, "S0310", 11, 12)
    assert dataset.sequences[0].attributes == {"BC", "OM", "IV", "SV"}
    assert dataset.sequences[1].attributes == {"BC", "CM", "OB", "SV", "LO"}


def test_uavdt_skips_what_lacks_images_or_boxes(uavdt: Path) -> None:
    boxes = uavdt / "UAV-benchmark-SOT_v1.0" / "anno"
    write_truth(boxes / "S0201_gt.txt", 3)
    write_images(uavdt / "UAV-benchmark-S" / "S0301", [1], "img{:06d}.jpg")
    (uavdt / "UAV-benchmark-S" / "S0101" / "img000002.jpg").unlink()
    dataset = read_dataset(uavdt)
    assert names(dataset) == ["S0310"]
    assert [skipped.name for skipped in dataset.skipped] == ["S0101", "S0201", "S0301"]
    assert dataset.skipped[0].why == "S0101 has 2 images and 3 lines of ground truth"
    assert dataset.skipped[1].why.endswith("S0201, the folder of its images, is missing")
    assert dataset.skipped[2].why.endswith("S0301_gt.txt cannot be read: No such file or directory")


def test_half_of_uavdt_is_told_what_it_lacks(uavdt: Path) -> None:
    (uavdt / "UAV-benchmark-SOT_v1.0").rename(uavdt / "elsewhere")
    with pytest.raises(SourceError, match=r"anno is missing: UAVDT has its images in UAV-benchmark-S and"):
        read_dataset(uavdt)


# --- OTB100 ---


def write_otb(folder: Path, numbers: Iterable[int], *, lines: int, truth: str = "groundtruth_rect.txt") -> None:
    write_images(folder / "img", numbers, "{:04d}.jpg")
    write_truth(folder / truth, lines)


@pytest.mark.parametrize("separator", [",", "\t", " ", ", "])
def test_otb_separates_by_comma_tab_or_blank(tmp_path: Path, separator: str) -> None:
    write_images(tmp_path / "Boy" / "img", range(1, 4), "{:04d}.jpg")
    truth = write_truth(tmp_path / "Boy" / "groundtruth_rect.txt", 3, separator)
    dataset = read_dataset(tmp_path)
    assert dataset.name == "OTB100"
    assert dataset.sequences[0].truth == truth
    assert dataset.sequences[0].attributes == {"SV", "MB", "FM", "IPR", "OPR"}


@pytest.mark.parametrize(
    ("name", "first", "last"),
    [("David", 300, 770), ("Diving", 1, 215), ("Football1", 1, 74), ("Freeman3", 1, 460), ("Freeman4", 1, 283)],
)
def test_otb_annotates_only_a_part_of_some_sequences(tmp_path: Path, name: str, first: int, last: int) -> None:
    write_otb(tmp_path / name, range(1, last + 8), lines=last - first + 1)
    dataset = read_dataset(tmp_path)
    sequence = dataset.sequences[0]
    assert (sequence.images[0].stem, sequence.images[-1].stem) == (f"{first:04d}", f"{last:04d}")
    assert sequence.truth[0] == Box(10, 20, 30, 40)
    assert shows(dataset, name, 0, first)


def test_otb_may_begin_with_another_image_than_the_first_and_end_absent(tmp_path: Path) -> None:
    write_otb(tmp_path / "BlurCar1", range(247, 250), lines=3)
    truth = tmp_path / "BlurCar1" / "groundtruth_rect.txt"
    truth.write_text("\n".join([*truth.read_text().splitlines()[:2], "0\t0\t0\t0"]))
    sequence = read_dataset(tmp_path).sequences[0]
    assert [path.stem for path in sequence.images] == ["0247", "0248", "0249"]
    assert [box is None for box in sequence.truth] == [False, False, True]


def test_otb_with_two_targets_is_two_sequences_of_the_same_images(tmp_path: Path) -> None:
    write_otb(tmp_path / "Jogging", range(1, 4), lines=3, truth="groundtruth_rect.1.txt")
    second = write_truth(tmp_path / "Jogging" / "groundtruth_rect.2.txt", 3, first=50)
    write_otb(tmp_path / "Human4", range(1, 3), lines=2, truth="groundtruth_rect.2.txt")
    (tmp_path / "Human4" / "groundtruth_rect.1.txt").touch()  # published empty
    dataset = read_dataset(tmp_path)
    assert names(dataset) == ["Human4-2", "Jogging-1", "Jogging-2"]
    assert dataset.skipped == ()
    assert dataset.sequences[1].images == dataset.sequences[2].images
    assert dataset.sequences[1].truth[0] == Box(10, 20, 30, 40)
    assert dataset.sequences[2].truth == second
    assert [s.attributes for s in dataset.sequences] == [{"IV", "SV", "OCC", "DEF"}, *2 * [{"OCC", "DEF", "OPR"}]]


def test_otb_skips_what_lacks_an_image_its_boxes_or_a_line(tmp_path: Path) -> None:
    write_otb(tmp_path / "Boy", range(1, 4), lines=3)
    write_otb(tmp_path / "Football1", [n for n in range(1, 82) if n != 50], lines=74)
    write_images(tmp_path / "Girl" / "img", [1], "{:04d}.jpg")
    write_otb(tmp_path / "Woman", range(1, 4), lines=2)
    write_truth(tmp_path / "Suv" / "groundtruth_rect.txt", 2)
    dataset = read_dataset(tmp_path)
    assert names(dataset) == ["Boy"]
    reasons = {skipped.name: skipped.why for skipped in dataset.skipped}
    assert reasons["Football1"].endswith("lacks image 50, 1 of its images 1 to 74 in all")
    assert reasons["Girl"].endswith("groundtruth_rect.txt cannot be read: No such file or directory")
    assert reasons["Suv"].endswith("img, the folder of its images, is missing")
    assert reasons["Woman"] == "Woman has 3 images and 2 lines of ground truth"


def test_sequences_of_others_in_otbs_layout_have_their_folders_name_and_no_attributes(tmp_path: Path) -> None:
    write_otb(tmp_path / "mine" / "kite", range(1, 3), lines=2)
    dataset = read_dataset(tmp_path / "mine")
    assert (dataset.name, names(dataset)) == ("mine", ["kite"])
    assert dataset.sequences[0].attributes == frozenset()


def test_otb100_has_98_folders_and_eleven_attributes() -> None:
    table = otb.attributes()
    assert len(table) == 98
    assert frozenset().union(*table.values()) == {"IV", "SV", "OCC", "DEF", "MB", "FM", "IPR", "OPR", "OV", "BC", "LR"}
    assert table.keys() >= otb.RANGES.keys()


# --- DTB70 ---


def test_dtb70_is_known_by_its_names_and_five_digits_and_has_flags_beside_it(tmp_path: Path) -> None:
    for name in ("Gull2", "Basketball"):
        write_images(tmp_path / name / "img", range(1, 4), "{:05d}.jpg")
        write_truth(tmp_path / name / "groundtruth_rect.txt", 3)
    (tmp_path / "anno" / "att").mkdir(parents=True)
    (tmp_path / "anno" / "att" / "Gull2.txt").write_text("0,1,0,1,0,1,0,0,0,1,0\n")
    dataset = read_dataset(tmp_path)
    assert (dataset.name, names(dataset), dataset.skipped) == ("DTB70", ["Basketball", "Gull2"], ())
    assert dataset.sequences[1].attributes == {"ARV", "DEF", "IPR", "SOA"}
    assert dataset.sequences[1].truth[0] == Box(10, 20, 30, 40)
    assert shows(dataset, "Gull2", 2, 3)
    assert dataset.sequences[0].attributes == frozenset()  # OTB100's Basketball has some


@pytest.mark.parametrize(("digits", "expected"), [("{:05d}.jpg", "DTB70"), ("{:04d}.jpg", "OTB100")])
def test_a_name_that_dtb70_and_otb100_share_is_told_by_its_digits(tmp_path: Path, digits: str, expected: str) -> None:
    write_images(tmp_path / "Walking" / "img", range(1, 3), digits)
    write_truth(tmp_path / "Walking" / "groundtruth_rect.txt", 2)
    assert read_dataset(tmp_path).name == expected


def test_dtb70_skips_what_lacks_an_image_or_its_boxes(tmp_path: Path) -> None:
    for name in ("Gull1", "Gull2", "Zebra"):
        write_images(tmp_path / name / "img", range(1, 4), "{:05d}.jpg")
        write_truth(tmp_path / name / "groundtruth_rect.txt", 3)
    (tmp_path / "Gull1" / "img" / "00002.jpg").unlink()
    (tmp_path / "Zebra" / "groundtruth_rect.txt").unlink()
    dataset = read_dataset(tmp_path)
    assert names(dataset) == ["Gull2"]
    assert dataset.skipped[0] == Skipped("Gull1", "Gull1 has 2 images and 3 lines of ground truth")
    assert dataset.skipped[1].why.endswith("groundtruth_rect.txt cannot be read: No such file or directory")


def test_dtb70s_images_in_the_plain_layout_are_read_as_that(tmp_path: Path) -> None:
    write_images(tmp_path / "set" / "Gull2" / "img", range(1, 3), "{:05d}.jpg")
    write_truth(tmp_path / "set" / "Gull2" / "groundtruth.txt", 2)
    dataset = read_dataset(tmp_path / "set")
    assert (dataset.name, names(dataset)) == ("set", ["Gull2"])


def test_dtb70_has_seventy_names() -> None:
    assert len(dtb70.NAMES) == 70


# --- VOT ---


@pytest.fixture
def vot(tmp_path: Path) -> Path:
    """`fish` with polygons and a colour folder, `ball` with boxes and images beside the boxes."""
    (tmp_path / "list.txt").write_text("fish\nball\n")
    write_images(tmp_path / "fish" / "color", range(1, 4), "{:08d}.jpg")
    (tmp_path / "fish" / "groundtruth.txt").write_text(
        "10.5,20,30,12,34,22,14.5,30\n0,0,4,0,4,3,0,3\nnan,nan,nan,nan,nan,nan,nan,nan\n"
    )
    (tmp_path / "fish" / "occlusion.tag").write_text("0\n0\n1\n")
    (tmp_path / "fish" / "camera_motion.tag").write_text("0\n0\n0\n")
    (tmp_path / "fish" / "practical.value").write_text("0.1\n")
    write_images(tmp_path / "ball", range(1, 3), "{:08d}.jpg")
    (tmp_path / "ball" / "groundtruth.txt").write_text("5,6,7,8\n6,6,7,8\n")
    (tmp_path / "ball" / "size_change.label").write_text("1\n1\n")
    return tmp_path


def test_a_polygon_of_vot_becomes_the_upright_box_around_it_and_is_0_based(vot: Path) -> None:
    dataset = read_dataset(vot)
    assert (dataset.name, names(dataset), dataset.skipped) == ("VOT", ["fish", "ball"], ())
    fish, ball = dataset.sequences
    assert fish.truth == (Box(10.5, 12, 23.5, 18), Box(0, 0, 4, 3), None)
    assert ball.truth == (Box(5, 6, 7, 8), Box(6, 6, 7, 8))
    assert [path.name for path in fish.images] == [f"{number:08d}.jpg" for number in (1, 2, 3)]
    assert shows(dataset, "fish", 1, 2)
    assert shows(dataset, "ball", 1, 2)
    assert fish.attributes == {"occlusion"}
    assert ball.attributes == {"size_change"}


def test_vot_skips_what_it_lists_but_has_not_whole(vot: Path) -> None:
    (vot / "list.txt").write_text("fish\nball\nghost\nmask\n")
    (vot / "ball" / "00000001.jpg").unlink()
    write_images(vot / "mask" / "color", [1], "{:08d}.jpg")
    (vot / "mask" / "groundtruth.txt").write_text("m10,20,4,4,2,2\n")  # since 2020
    dataset = read_dataset(vot)
    assert names(dataset) == ["fish"]
    reasons = {skipped.name: skipped.why for skipped in dataset.skipped}
    assert reasons["ball"] == "ball has 1 images and 2 lines of ground truth"
    assert reasons["ghost"].endswith("ghost, the folder of its images, is missing")
    assert reasons["mask"].endswith("expected x,y,w,h or x1,y1,x2,y2,x3,y3,x4,y4, got 'm10,20,4,4,2,2'")


@pytest.mark.parametrize("name", ["fish", "x" * 300])
def test_what_cannot_be_opened_is_told_in_one_line(vot: Path, name: str) -> None:
    (vot / "list.txt").write_text(name)
    (vot / "fish" / "groundtruth.txt").unlink()
    with pytest.raises(SourceError, match=r"cannot be read: (No such file|.*File name too long)"):
        read_dataset(vot)


def test_a_list_of_another_data_set_is_not_read_as_vots(vot: Path, plain: Path) -> None:
    """GOT-10k has the layout of VOT, but 1-based boxes; a plain folder may have a list."""
    (vot / "fish").rename(vot / "GOT-10k_Val_000001")
    (vot / "list.txt").write_text("GOT-10k_Val_000001\n")
    with pytest.raises(SourceError, match="has no whole sequence"):
        read_dataset(vot)
    (plain / "list.txt").write_text("bay\nalp\n")
    assert read_dataset(plain).sequences[1].truth[0] == Box(10, 20, 30, 40)
