"""The unit and the account, by what systemd itself says of them."""

import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import pytest

from companion.signing import CREDENTIAL, KEY_SIZE, parse_key

SYSTEMD = Path(__file__).resolve().parents[2] / "systemd"
UNIT = SYSTEMD / "mscf-companion.service"
SYSUSERS = SYSTEMD / "mscf-companion.sysusers"
MODULES = "modprobe@videodev.service modprobe@cdc_acm.service modprobe@usbserial.service"

Directives = dict[tuple[str, str], list[str]]


def analyze_version() -> int:
    """Version of systemd-analyze; 0 where there is none."""
    path = shutil.which("systemd-analyze")
    if path is None:
        return 0
    said = subprocess.run([path, "--version"], capture_output=True, text=True, check=True).stdout
    found = re.match(r"systemd (\d+)", said)
    return int(found[1]) if found else 0


needs_analyze = pytest.mark.skipif(analyze_version() < 250, reason="no systemd-analyze of systemd 250 or newer")


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [shutil.which("systemd-analyze") or "", "--no-pager", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def security(unit: Path) -> subprocess.CompletedProcess[str]:
    return analyze("security", "--offline=true", "--threshold=20", str(unit))


def verify(unit: Path) -> subprocess.CompletedProcess[str]:
    return analyze("verify", "--man=no", "--recursive-errors=no", str(unit))


def directives(lines: Iterable[str]) -> Directives:
    """(section, key) -> its values in order, as a unit may say a key more than once."""
    found: Directives = defaultdict(list)
    section = ""
    for line in lines:
        if line.startswith("["):
            section = line.strip("[]")
        elif line and not line.startswith("#"):
            key, value = line.split("=", 1)
            found[section, key].append(value)
    return dict(found)


UNIT_SAYS = directives(UNIT.read_text().splitlines())


def with_command_at(program: Path, folder: Path, text: str | None = None) -> Path:
    """A copy of the unit that starts a program that exists, with the arguments of the real one."""
    text = UNIT.read_text() if text is None else text
    copy = folder / UNIT.name
    copy.write_text(re.sub(r"(?m)^ExecStart=\S+", f"ExecStart={program}", text))
    return copy


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "mscf-companion"
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return path


@needs_analyze
def test_systemd_finds_nothing_to_say_against_the_unit(program: Path, tmp_path: Path) -> None:
    done = verify(with_command_at(program, tmp_path))
    assert done.stdout + done.stderr == ""
    assert done.returncode == 0


@needs_analyze
def test_the_check_would_see_a_misspelt_directive(program: Path, tmp_path: Path) -> None:
    done = verify(with_command_at(program, tmp_path, UNIT.read_text().replace("WatchdogSec", "WatchDogSec")))
    assert "WatchDogSec" in done.stderr


@needs_analyze
def test_the_check_would_see_a_program_that_is_not_there(tmp_path: Path) -> None:
    done = verify(with_command_at(tmp_path / "nothing", tmp_path))
    assert "is not executable" in done.stderr


@needs_analyze
def test_the_drop_in_for_an_encrypted_key_is_as_good(program: Path, tmp_path: Path) -> None:
    unit, readme = UNIT.read_text(), (SYSTEMD / "README.md").read_text()
    (line,) = re.findall(r"(?m)^ *(LoadCredentialEncrypted=.+)$", readme)
    unit = unit.replace("UMask=", f"LoadCredential=\n{line}\nUMask=")
    done = verify(with_command_at(program, tmp_path, unit))
    assert done.stdout + done.stderr == ""
    assert line.split("=")[1].split(":")[0] == CREDENTIAL


@needs_analyze
def test_the_exposure_is_at_most_2() -> None:
    done = security(UNIT)
    assert done.returncode == 0, done.stdout
    found = re.search(r"Overall exposure level for mscf-companion.service: (\S+) OK", done.stdout)
    assert found is not None, done.stdout
    assert float(found[1]) <= 2.0


@needs_analyze
def test_the_same_threshold_refuses_a_unit_without_protection(tmp_path: Path) -> None:
    kept = [line for line in UNIT.read_text().splitlines() if not re.match("Protect|Restrict|SystemCall|Cap", line)]
    bare = tmp_path / UNIT.name
    bare.write_text("\n".join(kept))
    assert security(bare).returncode != 0


DEMANDED = {
    # start, stop, restart
    ("Unit", "Wants"): [MODULES],
    ("Unit", "After"): [MODULES, "network.target"],
    ("Unit", "StartLimitIntervalSec"): ["60"],
    ("Unit", "StartLimitBurst"): ["5"],
    ("Service", "Type"): ["notify"],
    ("Service", "NotifyAccess"): ["main"],
    ("Service", "ExecStart"): [
        "/opt/mscf-companion/venv/bin/mscf-companion run -c /etc/mscf-companion/config.toml",
    ],
    ("Service", "WatchdogSec"): ["5"],
    ("Service", "TimeoutStopSec"): ["10"],
    ("Service", "Restart"): ["on-failure"],
    ("Service", "RestartSec"): ["2"],
    ("Service", "RestartPreventExitStatus"): ["78"],
    ("Install", "WantedBy"): ["multi-user.target"],
    # account and folders
    ("Service", "User"): ["mscf-companion"],
    ("Service", "Group"): ["mscf-companion"],
    ("Service", "SupplementaryGroups"): ["video dialout"],
    ("Service", "UMask"): ["0027"],
    ("Service", "ConfigurationDirectory"): ["mscf-companion"],
    ("Service", "RuntimeDirectory"): ["mscf-companion"],
    ("Service", "RuntimeDirectoryMode"): ["0750"],
    ("Service", "StateDirectory"): ["mscf-companion"],
    ("Service", "StateDirectoryMode"): ["0750"],
    ("Service", "LogsDirectory"): ["mscf-companion"],
    ("Service", "LogsDirectoryMode"): ["0750"],
    ("Service", "LoadCredential"): ["signing-key:mscf-companion.signing-key"],
    # devices and network
    ("Service", "DevicePolicy"): ["closed"],
    ("Service", "DeviceAllow"): [f"char-{name} rw" for name in ("video4linux", "ttyAMA", "ttyACM", "ttyUSB", "ttyS")],
    ("Service", "RestrictAddressFamilies"): ["AF_UNIX AF_INET AF_INET6"],
    # everything else
    ("Service", "ProtectSystem"): ["strict"],
    ("Service", "ProtectProc"): ["invisible"],
    ("Service", "CapabilityBoundingSet"): [""],
    ("Service", "SystemCallArchitectures"): ["native"],
    ("Service", "SystemCallFilter"): ["@system-service", "~@privileged"],
    ("Service", "SystemCallErrorNumber"): ["EPERM"],
} | {
    ("Service", key): ["yes"]
    for key in (
        "ProtectHome",
        "PrivateTmp",
        "NoNewPrivileges",
        "RestrictNamespaces",
        "RestrictSUIDSGID",
        "LockPersonality",
        "ProtectKernelTunables",
        "ProtectKernelModules",
        "ProtectKernelLogs",
        "ProtectControlGroups",
        "ProtectClock",
        "ProtectHostname",
    )
}


@pytest.mark.parametrize(("name", "values"), DEMANDED.items(), ids=lambda value: "-".join(value)[:40])
def test_the_unit_says(name: tuple[str, str], values: list[str]) -> None:
    assert UNIT_SAYS[name] == values


@pytest.mark.parametrize(
    "trap",
    [
        "BindsTo",  # the application retries a device; a pulled cable must not stop it
        "DynamicUser",  # recordings would be for root only
        "MemoryDenyWriteExecute",  # breaks compilers at run time
        "ProcSubset",  # hides /proc/cpuinfo
        "PrivateDevices",  # hides camera and serial port
        "PrivateNetwork",  # cuts the link
    ],
)
def test_the_unit_stays_out_of_the_trap(trap: str) -> None:
    assert not [key for _, key in UNIT_SAYS if key == trap]


def test_a_missing_key_does_not_keep_the_service_from_starting() -> None:
    """With a path it would (exit status 243); a name is looked for in the credential stores, and may be missing."""
    (credential,) = UNIT_SAYS["Service", "LoadCredential"]
    name, source = credential.split(":")
    assert name == CREDENTIAL
    assert "/" not in source


def test_the_readme_makes_a_key_that_is_one() -> None:
    readme = (SYSTEMD / "README.md").read_text()
    (command,) = re.findall(r"python3 -c '(.+secrets.+?)'", readme)
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, check=True)
    assert len(parse_key(done.stdout)) == KEY_SIZE
    assert re.fullmatch(rb"[0-9a-f]{64}\n", done.stdout)
    assert UNIT_SAYS["Service", "LoadCredential"][0].split(":")[1] in readme


def test_the_filter_leaves_the_affinity_calls_of_blas_and_opencv() -> None:
    assert not any("@resources" in value for value in UNIT_SAYS["Service", "SystemCallFilter"])


@pytest.mark.skipif(shutil.which("systemd-sysusers") is None, reason="no systemd-sysusers")
def test_the_account_is_the_units_and_nobody_can_log_into_it(tmp_path: Path) -> None:
    (tmp_path / "etc").mkdir()
    command = [shutil.which("systemd-sysusers") or "", f"--root={tmp_path}", str(SYSUSERS)]
    subprocess.run(command, check=True, capture_output=True)
    name, _, uid, _, _, home, shell = (tmp_path / "etc" / "passwd").read_text().strip().split(":")
    assert [name] == UNIT_SAYS["Service", "User"]
    assert 0 < int(uid) < 1000
    assert home == f"/var/lib/{UNIT_SAYS['Service', 'StateDirectory'][0]}"
    assert shell.endswith("nologin")
    assert (tmp_path / "etc" / "group").read_text().startswith(f"{UNIT_SAYS['Service', 'Group'][0]}:")
