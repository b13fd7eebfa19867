"""Faults that leave every file complete and of the right form, as changes of a dataset.

The dataset has two scenes, 0 and 1; scene 0 or files of the whole dataset are damaged.
"""

import json
import shutil

import cv2
import numpy as np

from graycast.camera.decode import Reason
from graycast.dataset.files.seal import sealed, sha256
from graycast.dataset.write.claim import fingerprint

SCENE, OTHER = "train/000000", "train/000001"


def edit(name, change):
    """Edit JSON files of scene 0, or of the dataset if the name says so."""

    def do(out):
        for path in sorted(out.glob(name)):
            content = json.loads(path.read_text())
            change(content)
            path.write_text(json.dumps(content))

    return do


def claim(change):
    return edit("graycast.json", change)


def manifest(change):
    return edit(f"{SCENE}/manifest.json", change)


def picture(name, change, *also):
    """Repaint a picture of scene 0 in its own bit depth; `also` is called afterwards."""

    def do(out):
        path = out / SCENE / name / "000000.png"
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        new = np.ascontiguousarray(change(image)).astype(image.dtype)
        assert new.shape != image.shape or (new != image).any(), "nothing was damaged"
        cv2.imwrite(str(path), new)
        for further in also:
            further(out)

    return do


def taken(name):
    """Take a picture from the other scene."""
    return lambda out: shutil.copy(
        out / OTHER / name / "000000.png", out / SCENE / name / "000000.png"
    )


def further(by_mm):
    """Write a larger depth, in steps of 0.02 mm."""
    return lambda d: np.where(d > 0, d.astype(int) + round(by_mm / 0.02), 0)


def one_part(by_mm):
    def do(out):
        mask = cv2.imread(str(out / SCENE / "mask_visib/000000_000000.png"), -1) > 0
        picture("depth_sl", lambda d: np.where(mask & (d > 0), d + round(by_mm / 0.02), d))(out)

    return do


def background(by_mm):
    def do(out):
        part = np.zeros((240, 320), dtype=bool)
        for path in (out / SCENE / "mask_visib").iterdir():
            part |= cv2.imread(str(path), -1) > 0
        picture("depth", lambda d: np.where(part, d, d.astype(int) + round(by_mm / 0.02)))(out)

    return do


def moved(down, right):
    return lambda image: np.roll(image, (down, right), axis=(0, 1))


def rewritten(old, new):
    return lambda reason: np.where(reason == old, new, reason)


def shares(out):
    """Set the shares in the manifest to those of the map of reasons."""
    reason = cv2.imread(str(out / SCENE / "reason_sl/000000.png"), -1)
    entries = {r.name.lower(): float((reason == r).mean()) for r in Reason}
    manifest(lambda m: m["reasons"].update(entries))(out)


def noisy(image):
    rng = np.random.default_rng(0)
    return np.where(image > 0, image + np.rint(rng.normal(0, 25, image.shape)), 0)


def palette(out):
    from PIL import Image

    path = out / SCENE / "rgb/000000.png"
    with Image.open(path) as image:
        image.quantize(256).save(path)


def packed_otherwise(out):
    path = out / SCENE / "rgb/000000.png"
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def world(turn_deg=(0.0, 0.0, 0.0), shift_mm=(0.0, 0.0, 0.0)):
    """Write rigid poses of the world that differ from those of the scene."""
    R, _ = cv2.Rodrigues(np.radians(np.array(turn_deg, dtype=float)))

    def change(view):
        W = np.array(view["0"]["cam_R_w2c"]).reshape(3, 3)
        view["0"]["cam_t_w2c"] = (np.array(view["0"]["cam_t_w2c"]) - W @ R @ shift_mm).tolist()
        view["0"]["cam_R_w2c"] = (W @ R).ravel().tolist()

    return edit(f"{SCENE}/scene_camera*.json", change)


def cameras(change, in_claim=None):
    """Change all files that describe the camera: the scenes', the dataset's, perhaps the claim."""

    def do(out):
        edit("train/*/scene_camera*.json", lambda v: change(v["0"]["cam_K"]))(out)
        content = json.loads((out / "camera.json").read_text())
        K = [content["fx"], 0, content["cx"], 0, content["fy"], content["cy"], 0, 0, 1]
        change(K)
        content |= {"fx": K[0], "cx": K[2], "fy": K[4], "cy": K[5]}
        (out / "camera.json").write_text(json.dumps(content))
        if in_claim is not None:
            claim(in_claim)(out)

    return do


def half_a_pixel(K):
    K[2] += 0.5
    K[5] += 0.5


def half_a_pixel_in_the_claim(c):
    c["rig"]["camera"]["cx_px"] += 0.5
    c["rig"]["camera"]["cy_px"] += 0.5


def longer(K):
    K[0] *= 1.01
    K[4] *= 1.01


def scale(factor, *, everywhere):
    def do(out):
        edit("train/*/scene_camera*.json", lambda v: v["0"].update(depth_scale=0.02 * factor))(out)
        edit("camera.json", lambda c: c.update(depth_scale=0.02 * factor))(out)
        if everywhere:
            claim(lambda c: c.update(depth_scale_mm=0.02 * factor))(out)

    return do


def swapped(name):
    def do(out):
        one, other = out / SCENE / name, out / OTHER / name
        data = one.read_bytes()
        one.write_bytes(other.read_bytes())
        other.write_bytes(data)

    return do


def scene_again(out):
    shutil.rmtree(out / SCENE)
    shutil.copytree(out / OTHER, out / SCENE)


def hidden_part(out):
    """Remove the last instance from every list, with its masks."""
    number = len(list((out / SCENE / "mask").iterdir())) - 1
    for kind in ("mask", "mask_visib", "mask_sl", "mask_visib_sl"):
        (out / SCENE / kind / f"000000_{number:06d}.png").unlink()
    for name in ("scene_gt*.json", "scene_gt_info*.json", "scene_gt_box3d.json"):
        for path in (out / SCENE).glob(name):
            content = json.loads(path.read_text())
            if "0" in content and len(content["0"]) > number:
                content["0"].pop()
            if "annotations" in content:
                content["annotations"].pop()
            path.write_text(json.dumps(content))


def stray(out):
    (out / SCENE / "notes.txt").write_text("seen by me")


def without_sums(out):
    for name in ("sha256", "manifest_sha256"):
        manifest(lambda m, name=name: m.pop(name))(out)


def model_line(old, new):
    def do(out):
        path = out / "models/obj_000001.ply"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return do


def recolored(out):
    """Give every vertex of the first model another colour."""
    path = out / "models/obj_000001.ply"
    head, body = path.read_text().split("end_header\n")
    columns = [line.split()[-1] for line in head.splitlines() if line.startswith("property")]
    red = columns.index("red")
    count = int(next(line for line in head.splitlines() if "element vertex" in line).split()[-1])
    lines = body.splitlines()
    for k in range(count):
        words = lines[k].split()
        words[red] = str(255 - int(words[red]))
        lines[k] = " ".join(words)
    path.write_text(head + "end_header\n" + "\n".join(lines) + "\n")


def reseal(out):
    """Compute all checksums again, as a person who knows the format would do after a change."""
    for scene in (out / "train").iterdir():
        path = scene / "manifest.json"
        record = json.loads(path.read_text())
        record = {k: v for k, v in record.items() if k not in ("sha256", "manifest_sha256")}
        files = {
            str(p.relative_to(scene)): p.read_bytes()
            for p in scene.rglob("*")
            if p.is_file() and p != path
        }
        path.write_bytes(dict(sealed(files.items(), record))["manifest.json"])
    path = out / "graycast.json"
    record = json.loads(path.read_text())
    record["sha256"] = {name: sha256((out / name).read_bytes()) for name in record["sha256"]}
    record["fingerprint"] = fingerprint(record)
    path.write_text(json.dumps(record))


# Each of these faults is detected even without checksums; the text is part of the message.
KNOWN = {
    "scanner depth 3 px to the right": (picture("depth_sl", moved(0, 3)), "depth_sl and reason_sl"),
    "scanner depth mirrored": (picture("depth_sl", np.fliplr), "depth_sl and reason_sl disagree"),
    "scanner depth of another scene": (taken("depth_sl"), "depth_sl and reason_sl disagree"),
    "perfect depth 1 mm deeper": (picture("depth", further(1.0)), "depth is off the model"),
    "perfect depth mirrored": (picture("depth", np.fliplr), "depth is off the model"),
    "perfect depth 1 px to the left": (picture("depth", moved(0, -1)), "depth is off the model"),
    "perfect depth of another scene": (taken("depth"), "depth is off the model"),
    "colour with a palette": (palette, "palette"),
    "another seed of the dataset in a manifest": (
        manifest(lambda m: m.update(dataset_seed=8)),
        "differ in dataset_seed .8 there, 0 here",
    ),
    "another number of the scene": (manifest(lambda m: m.update(scene_id=1)), "scene_id is 1"),
    "another configuration in a manifest": (
        manifest(lambda m: m["config"]["render"].update(samples=64)),
        "differ in config.render.samples .64 there",
    ),
    "two manifests exchanged": (swapped("manifest.json"), "scene_id is 1"),
    "a scene that is a copy of another": (scene_again, "scene_id is 1"),
    "another focal length in the claim": (
        claim(lambda c: c["rig"]["camera"].update(fx_px=c["rig"]["camera"]["fx_px"] + 1)),
        "camera.json: fx is",
    ),
    "another size of the camera in the claim": (
        claim(lambda c: c["rig"]["camera"].update(width_px=321)),
        "camera.json: width is",
    ),
    "a distortion in the claim": (
        claim(lambda c: c["rig"]["camera"].update(distortion=[0.01, 0.0, 0.0, 0.0, 0.0])),
        "camera.json: distortion",
    ),
    "another seed in the claim": (
        claim(lambda c: c.update(seed=9)),
        "differ in dataset_seed .0 there, 9 here",
    ),
    "another depth step in the claim": (
        claim(lambda c: c.update(depth_scale_mm=0.01)),
        "depth_scale is 0.02, graycast.json has",
    ),
    "another name of a part": (
        claim(lambda c: c["parts"][0].update(name="lid")),
        "categories are not the parts",
    ),
    "centres of pixels at their corners, in all files": (
        cameras(half_a_pixel, half_a_pixel_in_the_claim),
        "differs from the model",
    ),
    "a focal length 1 % longer, but for the claim": (cameras(longer), "camera.json: fx is"),
    "a depth step half as large, but for the claim": (
        scale(0.5, everywhere=False),
        "depth_scale is 0.01",
    ),
    "a depth step half as large in all files": (scale(0.5, everywhere=True), "off the model"),
    "a part that no file knows": (hidden_part, "the scene has 5"),
}

# Only the checksums reveal these changes.
SUMS_ALONE = {
    "scanner depth 1 mm deeper": picture("depth_sl", further(1.0)),
    "scanner depth 1 mm nearer": picture("depth_sl", further(-1.0)),
    "scanner depth 10 mm deeper": picture("depth_sl", further(10.0)),
    "scanner depth of one part 10 mm deeper": one_part(10.0),
    "background 5 mm deeper": background(5.0),
    "background 5 mm nearer": background(-5.0),
    "colour 5 px to the right": picture("rgb", moved(0, 5)),
    "colour 4 px down": picture("rgb", moved(4, 0)),
    "colour mirrored": picture("rgb", np.fliplr),
    "colour upside down": picture("rgb", np.flipud),
    "colour all black": picture("rgb", np.zeros_like),
    "colour all grey": picture("rgb", lambda p: np.full_like(p, 128)),
    "colour all noise": picture(
        "rgb", lambda p: np.random.default_rng(0).integers(0, 256, p.shape)
    ),
    "white frame 5 px to the right": picture("gray_sl", moved(0, 5)),
    "white frame 3 px up": picture("gray_sl", moved(-3, 0)),
    "white frame mirrored": picture("gray_sl", np.fliplr),
    "white frame all black": picture("gray_sl", np.zeros_like),
    "white frame at half its light": picture("gray_sl", lambda g: g // 2),
    "white frame of another scene": taken("gray_sl"),
    "shadow called outlier": picture("reason_sl", rewritten(Reason.SHADOW, Reason.OUTLIER)),
    "shadow called outlier, with its share": picture(
        "reason_sl", rewritten(Reason.SHADOW, Reason.OUTLIER), shares
    ),
    "shadow called saturated, with its share": picture(
        "reason_sl", rewritten(Reason.SHADOW, Reason.SATURATED), shares
    ),
    "contradictions called shadow, with their share": picture(
        "reason_sl", rewritten(Reason.CONTRADICTORY, Reason.SHADOW), shares
    ),
    "contradictions called outliers": picture(
        "reason_sl", rewritten(Reason.CONTRADICTORY, Reason.OUTLIER)
    ),
    "modulation halved": picture("modulation_sl", lambda m: m // 2),
    "modulation's step halved": edit(
        f"{SCENE}/scene_sl.json",
        lambda s: s["0"].update(modulation_scale=s["0"]["modulation_scale"] / 2),
    ),
    "modulation's step doubled": edit(
        f"{SCENE}/scene_sl.json",
        lambda s: s["0"].update(modulation_scale=s["0"]["modulation_scale"] * 2),
    ),
    "modulation a tenth stronger": picture("modulation_sl", lambda m: np.minimum(m * 1.1, 65535.0)),
    "modulation 5 px down": picture("modulation_sl", moved(5, 0)),
    "modulation of another scene": taken("modulation_sl"),
    "modulation the same everywhere": picture("modulation_sl", lambda m: np.full_like(m, 40000)),
    "a world turned by 1 degree": world((1.0, 0.0, 0.0)),
    "a world turned by a quarter": world((0.0, 0.0, 90.0)),
    "a world turned about the vertical by 5 degrees": world((0, 0, 5.0)),
    "a world upside down": world((180.0, 0.0, 0.0)),
    "a world 5 mm higher": world(shift_mm=(0, 0, 5.0)),
    "a world 5 mm lower": world(shift_mm=(0, 0, -5.0)),
    "a world 10 mm aside": world(shift_mm=(10.0, 0, 0)),
    "another seed of the noise": manifest(
        lambda m: m["seeds"].update(noise=m["seeds"]["noise"] + 1)
    ),
    "a manifest's shares exchanged": manifest(
        lambda m: m["reasons"].update(
            shadow=m["reasons"]["decoded"], decoded=m["reasons"]["shadow"]
        )
    ),
    "a manifest's share a hundredth higher": manifest(
        lambda m: m["reasons"].update(decoded=m["reasons"]["decoded"] + 0.01)
    ),
    "a manifest without its shares": manifest(lambda m: m.pop("reasons")),
    "another number of parts in a manifest": manifest(lambda m: m["counts"].update(box=1)),
    "another threshold in the claim": claim(
        lambda c: c["config"]["scanner"]["decode"].update(min_contrast=0.1)
    ),
    "scanner depth noisier by half a millimetre": picture("depth_sl", noisy),
    "colours in another order": picture("rgb", lambda p: p[..., ::-1]),
    "colour half as bright": picture("rgb", lambda p: p // 2),
    "the same picture packed otherwise": packed_otherwise,
    "contradictions called outliers, with their share": picture(
        "reason_sl", rewritten(Reason.CONTRADICTORY, Reason.OUTLIER), shares
    ),
    "shadows called outside the projector, with their share": picture(
        "reason_sl", rewritten(Reason.SHADOW, Reason.OUTSIDE_PROJECTOR), shares
    ),
    "another exposure time": manifest(lambda m: m.update(exposure_s=2 * m["exposure_s"])),
    "parts that never came to rest": manifest(lambda m: m["physics"].update(at_rest=False)),
    "another version of a library": manifest(lambda m: m["versions"].update(numpy="1.0")),
    "another baseline in the claim": claim(
        lambda c: c["rig"]["T_cam_proj"][0].__setitem__(3, 0.36)
    ),
    "another material of a part": claim(lambda c: c["parts"][0].update(content="0" * 64)),
    "a model in other colours": recolored,
    "a model with a symmetry more": edit(
        "models/models_info.json",
        lambda i: i["1"].update(symmetries_continuous=[{"axis": [0, 0, 1], "offset": [0, 0, 0]}]),
    ),
}

# These changes are valid once the checksums are computed again.
OF_SUMS = {
    "a file more": (stray, "notes.txt was not written with the scene"),
    "a manifest without sums": (
        without_sums,
        "a file of the scene was changed, removed or added was not checked",
    ),
    "a claim without sums": (
        claim(lambda c: c.pop("sha256")),
        "models and cameras were changed was not checked",
    ),
}
