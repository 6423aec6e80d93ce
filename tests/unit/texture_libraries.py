"""Unpacks the Debian packages of texture_use_labels.csv into a folder, for SPECTEX_TEST_LIBRARIES.

    python3 texture_libraries.py FOLDER [PACKAGE ...]     (all of the list: 1.2 GB to download)
"""
import csv
import pathlib
import subprocess
import sys
import zipfile

# Games keep their pictures in zip archives of other names; they are unpacked beside the package's files.
ARCHIVES = {"warzone2100-data": {"base.wz": "wzbase"}, "openarena-data": {"baseoa/pak0.pk3": "pak0"}}

folder = pathlib.Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
labels = pathlib.Path(__file__).parent / "data" / "texture_use_labels.csv"
packages = sys.argv[2:] or sorted({row["package"] for row in csv.DictReader(labels.open())})
for package in packages:
    subprocess.run(["apt-get", "download", package], cwd=folder, check=True)
    deb = next(folder.glob(f"{package}_*.deb"))
    subprocess.run(["dpkg-deb", "-x", deb, folder / package], check=True)
    deb.unlink()
    for archive, name in ARCHIVES.get(package, {}).items():
        for found in (folder / package).rglob(archive):
            with zipfile.ZipFile(found) as z:
                z.extractall(folder / package / "unzipped" / name)
