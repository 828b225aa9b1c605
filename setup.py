"""The compiled core, which is optional: without a C++ compiler the package installs all the same, and uses NumPy."""

from pathlib import Path
from tempfile import TemporaryDirectory

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

BUILD = TemporaryDirectory(prefix="mscf-build-")  # new each time: nothing that an earlier build has left gets in


class BuildCore(build_ext):
    """Build the core; where that fails none is there, rather than that of an earlier source."""

    def run(self) -> None:
        """Build."""
        if self.inplace or self.editable_mode:
            for old in Path("mscf/kernels").glob("_native*.so"):
                old.unlink()
        super().run()


setup(
    cmdclass={"build_ext": BuildCore},
    ext_modules=[
        Extension(
            "mscf.kernels._native",
            sources=sorted(map(str, Path("mscf/kernels/src").glob("*.cpp"))),
            depends=sorted(map(str, Path("mscf/kernels/src").glob("*.hpp"))),
            language="c++",
            # no -ffast-math: what is not a number has to be seen as such
            extra_compile_args=[
                "-std=c++17",
                "-O3",
                "-g0",
                "-fno-wrapv",  # Python's own flags have -fwrapv, with which half of the loops are not vectorised
                "-fvisibility=hidden",
                "-fno-math-errno",
                "-fno-trapping-math",
                "-ffp-contract=fast",
            ],
            define_macros=[("Py_LIMITED_API", "0x030B0000")],  # one build for Python 3.11 and all later ones
            py_limited_api=True,
            optional=True,
        )
    ],
    options={
        "bdist_wheel": {"py_limited_api": "cp311"},
        "build": {"build_base": BUILD.name},
    },
)
