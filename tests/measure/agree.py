"""Holds the figures of `kiln compare --json` against an independent implementation.

  agree.py KILN MEASURE REFERENCE OTHER [--size 512] [--views 24] [--samples 500000] [--tolerance 0.02]

KILN is the command, MEASURE a folder with `rmse.py` and `geom.py` (numpy, Pillow, open3d), which ray-cast and query with
Embree and share no line with kiln. SSIM is held against scikit-image and FLIP against flip-evaluator, the authors' own
program, on the pictures that `rmse.py` draws; where either package is missing, its rows say so and count for nothing.

Exit codes: 0 every figure agrees, 1 one does not, 2 a program failed, 3 a needed package is missing.

Compared as 1 - SSIM and 1 - IoU: a difference of 2 % of a value close to 1 would say nothing. Below a figure's noise (the
last column: the precision of 32-bit rays; for the greatest distance, which is a maximum over samples, what three seeds of the
other implementation differ by) the difference may be as large as that noise instead.
"""
import argparse
import json
import subprocess
import sys

parser = argparse.ArgumentParser()
for name in ("kiln", "measure", "reference", "other"):
    parser.add_argument(name)
parser.add_argument("--size", type=int, default=512)
parser.add_argument("--views", type=int, default=24)
parser.add_argument("--samples", type=int, default=500000)
parser.add_argument("--tolerance", type=float, default=0.02)
arguments = parser.parse_args()
sys.path.insert(0, arguments.measure)
try:
    import numpy as np
    import common
    import geom
    import rmse
    import open3d  # noqa: F401
except ImportError as error:
    print(f"skipped: {error}")
    sys.exit(3)
try:
    from skimage.metrics import structural_similarity
except ImportError:
    structural_similarity = None
try:
    import flip_evaluator
except ImportError:
    flip_evaluator = None


def of_kiln():
    command = [arguments.kiln, "compare", arguments.reference, arguments.other, "--json", "--no-normal-maps"]
    for name in ("size", "views", "samples"):
        command += [f"--{name}", str(getattr(arguments, name))]
    said = subprocess.run(command, capture_output=True, text=True)
    if said.returncode != 0:
        print(said.stderr, file=sys.stderr)
        sys.exit(2)
    return json.loads(said.stdout)


def of_pictures(reference, other, mode):
    """Figures of all views in one mode, by name."""
    bench = rmse.Bench(reference, mode, arguments.size, arguments.views)
    scene = rmse.Scene(other, bench.c, bench.r, *bench.a)
    squares, object_squares, pixels, alike, seen = [], [], [], [], []
    ssim, ssim_object, flip, flip_object = [], [], [], []
    xor = cover = common_cover = either = 0.0
    for (first, first_cover), direction in zip(bench.ref, bench.dirs):
        second, second_cover = scene.image(direction, *bench.opt)
        square = ((first - second) ** 2).sum(-1)
        on = (first_cover > 0) | (second_cover > 0)
        squares.append(square.mean() / 3)
        object_squares.append(square[on].sum() / 3)
        pixels.append(on.sum())
        xor += np.abs(first_cover - second_cover).sum()
        cover += first_cover.sum()
        common_cover += np.minimum(first_cover, second_cover).sum()
        either += np.maximum(first_cover, second_cover).sum()
        if structural_similarity:
            luma = [image @ np.array([0.299, 0.587, 0.114]) for image in (first, second)]
            _, index = structural_similarity(*luma, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
                                             data_range=255, full=True)
            ssim.append(1 - index[5:-5, 5:-5].mean())
            alike.append((1 - index[5:-5, 5:-5])[on[5:-5, 5:-5]].sum())
            seen.append(on[5:-5, 5:-5].sum())
        if flip_evaluator:
            error, mean, _ = flip_evaluator.evaluate((first / 255).astype(np.float32), (second / 255).astype(np.float32),
                                                     "LDR", applyMagma=False, parameters={"ppd": 67.0})
            flip.append(mean)
            flip_object.append(error.reshape(on.shape)[on].sum())
    out = {"rmse": np.sqrt(np.mean(squares)), "rmse_object": np.sqrt(sum(object_squares) / max(sum(pixels), 1)),
           "rmse_worst": np.sqrt(max(squares)), "rmse_mean": np.sqrt(squares).mean(),
           "psnr": 20 * np.log10(255 / np.sqrt(np.mean(squares))) if sum(squares) > 0 else None,
           "1 - iou": 1 - common_cover / either, "xor": xor / cover}
    if ssim:
        out["1 - ssim"] = np.mean(ssim)
        out["1 - ssim object"] = sum(alike) / max(sum(seen), 1)
    if flip:
        out["flip"] = np.mean(flip)
        out["flip object"] = sum(flip_object) / max(sum(pixels), 1)
    return out


kiln = of_kiln()
reference, other = common.load(arguments.reference), common.load(arguments.other)
rows = []


def row(name, ours, theirs, noise):
    rows.append((name, ours, theirs, noise))


distances = [geom.Reference(reference, arguments.samples, seed).compare(other) for seed in (1, 11, 21)]
distance = distances[0]
for name in ("mean", "rms", "p99", "hausdorff"):
    # Against itself the other implementation measures 1e-8 diagonals.
    # The greatest distance of samples depends on the samples: twice what the other's own seeds differ by is its noise.
    values = [found[name] for found in distances]
    row(f"distance {name}", kiln["relative_distance"][name], float(np.median(values)),
        max(1e-7, 2 * (max(values) - min(values)) if name == "hausdorff" else 0.0))
row("normal degrees", kiln["distance"]["normal_degrees"], distance["normal_deg"], 0.02)
kept = None if np.isnan(distance["boundary"]) else distance["boundary"]
row("border kept", kiln["border_kept"], kept, 1e-6)
for mode, theirs in (("flat", of_pictures(reference, other, "unlit")), ("lit", of_pictures(reference, other, "lit"))):
    ours = kiln[mode]
    for name in ("rmse", "rmse_object", "rmse_worst", "rmse_mean"):
        row(f"{mode} {name}", ours[name], theirs[name], 0.02)
    row(f"{mode} psnr", ours["psnr"], theirs["psnr"], 0.0)
    for measure, turn in (("ssim", lambda value: 1 - value), ("flip", lambda value: value)):
        name = "1 - ssim" if measure == "ssim" else "flip"
        row(f"{mode} {name}", turn(ours[measure]["all"]), theirs.get(name), 1e-5)
        row(f"{mode} {name} object", turn(ours[measure]["object"]), theirs.get(f"{name} object"), 1e-5)
    if mode == "flat":
        row("silhouette 1 - iou", 1 - kiln["silhouette"]["iou"], theirs["1 - iou"], 1e-5)
        row("silhouette xor", kiln["silhouette"]["xor"], theirs["xor"], 1e-5)

failed = 0
print("%-24s %12s %12s %9s  %s" % ("figure", "kiln", "independent", "apart", "noise"))
for name, ours, theirs, noise in rows:
    if ours is None or theirs is None:
        both = ours is None and theirs is None
        says = "neither has one" if both else "not held: the other has none"
        if not both and ("ssim" not in name and "flip" not in name):
            failed += 1
            says = "only one has it"
        print("%-24s %12s %12s %9s  %s" % (name, ours, theirs, "", says))
        continue
    apart = abs(ours - theirs)
    agrees = apart <= max(arguments.tolerance * abs(theirs), noise)
    failed += not agrees
    share = 100 * apart / abs(theirs) if theirs else 0.0
    print("%-24s %12.6g %12.6g %8.2f%%  %g%s" % (name, ours, theirs, share, noise, "" if agrees else "  DISAGREES"))
print(f"{len(rows)} figures, {failed} disagree")
sys.exit(1 if failed else 0)
