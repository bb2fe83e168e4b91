"""Structure from motion by pycolmap, alone in its own process.

pycolmap and cv2 bring two copies of the same native libraries and have crashed together, so the camera provider starts
this file as a script: `python -P colmap_child.py REQUEST.json`. It imports nothing of `f4x_core`.

Request (JSON): `folder` (holds `images/NAME.png`, optional `masks/NAME.png.png`, 0 = ignored), `names` (in time order),
`pairs` (index pairs to match), `width`, `focal` (pixels), `refine_focal`, `max_features`, `threads` (of extraction and
matching), `seed`.
Answer: `folder/answer.npz` with `registered` (R,) int indices into `names`, `world_to_camera` (R,4,4), `focal`,
`points` (P,3), and the observations `frame`, `point` (O,) int and `uv` (O,2) pixels (pixel centres at +0.5).
The same request gets the same answer, however many threads work on it and whichever of them is first.
Features and matches stay in `folder/database.db` and are used again by a later request on the same folder.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pycolmap


def find_matches(request: dict, database: Path) -> None:
    """Write SIFT features of every image, and their matches over the requested pairs, to the database."""
    folder = Path(request["folder"])
    reader = pycolmap.ImageReaderOptions(camera_model="SIMPLE_PINHOLE")
    if (folder / "masks").is_dir():
        reader.mask_path = folder / "masks"
    extraction = pycolmap.FeatureExtractionOptions(num_threads=request["threads"])
    extraction.sift.max_num_features = request["max_features"]
    # Else images are numbered as threads finish them, and every later choice of the mapper follows the numbers.
    pycolmap.Database.open(database).close()
    pycolmap.import_images(database, folder / "images", pycolmap.CameraMode.SINGLE, request["names"], reader)
    pycolmap.extract_features(
        database, folder / "images", request["names"], pycolmap.CameraMode.SINGLE, reader, extraction
    )
    listing = folder / "pairs.txt"
    listing.write_text("".join(f"{request['names'][i]} {request['names'][j]}\n" for i, j in request["pairs"]))
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = request["seed"]
    verification.ransac.max_error = 2.0
    pycolmap.match_image_pairs(
        database,
        pycolmap.FeatureMatchingOptions(num_threads=request["threads"]),
        pycolmap.ImportedPairingOptions(match_list_path=listing),
        verification,
    )


def set_focal(request: dict, database: Path) -> None:
    """Put the focal prior into the single camera of the database."""
    with pycolmap.Database.open(database) as opened:
        (camera,) = opened.read_all_cameras()
        camera.focal_length = request["focal"]
        camera.has_prior_focal_length = True
        opened.update_camera(camera)


def solve(request: dict, database: Path) -> pycolmap.Reconstruction | None:
    """Map incrementally; return the reconstruction with most images, or None."""
    options = pycolmap.IncrementalPipelineOptions(
        multiple_models=False,
        extract_colors=False,
        num_threads=1,  # several threads add up large adjustments in another order each time
        random_seed=request["seed"],
        ba_refine_focal_length=request["refine_focal"],
        # The path is refined on dense tracks afterwards: fewer, looser global adjustments than COLMAP's own defaults.
        ba_global_frames_ratio=1.4,
        ba_global_points_ratio=1.4,
        ba_local_max_num_iterations=10,
        ba_local_max_refinements=1,
        ba_global_max_num_iterations=20,
        ba_global_max_refinements=2,
    )
    # Neighbouring video frames see little parallax: COLMAP's photo-collection angles would reject good points.
    options.mapper.init_min_tri_angle = 4.0
    options.mapper.abs_pose_max_error = 4.0
    options.mapper.filter_max_reproj_error = 2.0
    options.mapper.filter_min_tri_angle = 0.5
    options.mapper.num_threads = 1
    options.mapper.random_seed = request["seed"]
    options.mapper.abs_pose_refine_focal_length = False
    options.triangulation.min_angle = 0.5
    options.triangulation.random_seed = request["seed"]
    folder = Path(request["folder"])
    (folder / "models").mkdir(exist_ok=True)
    models = pycolmap.incremental_mapping(database, folder / "images", folder / "models", options)
    return max(models.values(), key=lambda model: model.num_reg_images()) if models else None


def main(path: str) -> None:
    """Answer the request in the file `path`."""
    request = json.loads(Path(path).read_text())
    folder = Path(request["folder"])
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    pycolmap.set_random_seed(request["seed"])
    database = folder / "database.db"
    if not database.exists():
        find_matches(request, database)
    set_focal(request, database)
    model = solve(request, database)

    index = {name: i for i, name in enumerate(request["names"])}
    images = sorted(
        (image for image in (model.images.values() if model else ()) if image.has_pose),
        key=lambda image: index[image.name],
    )
    points = dict(model.points3D.items()) if model else {}
    point_ids = {point: i for i, point in enumerate(points)}
    seen = [
        (index[image.name], point_ids[point.point3D_id], *point.xy)
        for image in images
        for point in image.points2D
        if point.has_point3D()
    ]
    rows = np.array(seen, np.float64).reshape(-1, 4)
    poses = [np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]]) for image in images]
    np.savez(
        folder / "answer.npz",
        registered=np.array([index[image.name] for image in images], np.int64),
        world_to_camera=np.array(poses, np.float64).reshape(-1, 4, 4),
        focal=next(iter(model.cameras.values())).focal_length if model else request["focal"],
        points=np.array([point.xyz for point in points.values()], np.float64).reshape(-1, 3),
        frame=rows[:, 0].astype(np.int64),
        point=rows[:, 1].astype(np.int64),
        uv=rows[:, 2:],
    )


if __name__ == "__main__":
    main(sys.argv[1])
