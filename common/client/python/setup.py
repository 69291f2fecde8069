"""The package `pleat`. Built by `make python`, which puts the generated messages in pleat/v1 first."""

import pathlib

from setuptools import setup

version: dict = {}
exec((pathlib.Path(__file__).parent / "pleat/version.py").read_text(), version)  # build.sh writes it

setup(
    name="pleat",
    version=version["__version__"],
    description="Client of Pleat: coarse cloth frames in, detailed collision-free fine frames out",
    license="Apache-2.0",
    packages=["pleat", "pleat.v1"],
    package_data={"pleat": ["py.typed"]},
    python_requires=">=3.9",
    install_requires=["grpcio>=1.51", "protobuf>=3.21", "numpy>=1.24", "h5py>=3.7"],
)
