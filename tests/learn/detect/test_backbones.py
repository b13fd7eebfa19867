"""Backbones: sizes of their maps, and the weights of published classifiers in them."""

from functools import cache

import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

import torchvision
from backends import slow
from torchvision.models.feature_extraction import create_feature_extractor

from graycast.base.errors import GraycastError
from graycast.learn.detect.backbones import BACKBONES, load_backbone, open_backbone

PUBLISHED = {
    "mobilenet-v3-small": torchvision.models.mobilenet_v3_small,
    "mobilenet-v2": torchvision.models.mobilenet_v2,
    "resnet18": torchvision.models.resnet18,
    "resnet50": torchvision.models.resnet50,
}
# These nodes of torchvision's own classifier have the same maps.
NODES = {
    "mobilenet-v3-small": ["features.1", "features.3", "features.8", "features.12"],
    "mobilenet-v2": ["features.3", "features.6", "features.13", "features.17"],
    "resnet18": ["layer1", "layer2", "layer3", "layer4"],
    "resnet50": ["layer1", "layer2", "layer3", "layer4"],
}


@cache
def classifier(name):
    """Return a network of torchvision, made once, whose norms differ from a new network's."""
    torch.manual_seed(1)
    network = PUBLISHED[name]()
    for norm in network.modules():
        if isinstance(norm, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(norm.running_mean, -0.1, 0.1)
            torch.nn.init.uniform_(norm.running_var, 0.5, 1.5)
    return network.eval()


def names_of(name):
    """Return the names and sizes of torchvision's weights, without their values."""
    with torch.device("meta"):
        return PUBLISHED[name]().state_dict()


@pytest.mark.parametrize("name", BACKBONES)
def test_every_map_has_the_size_and_channels_that_the_backbone_states(name):
    with torch.device("meta"):  # This needs only sizes, without weights and arithmetic.
        body = open_backbone(name, channels=4).eval()
        maps = body(torch.rand(1, 4, 64, 96))
    stated = [(1, c, 64 // s, 96 // s) for c, s in zip(body.channels, (4, 8, 16, 32), strict=True)]
    assert [tuple(m.shape) for m in maps] == stated


@pytest.mark.slow
@pytest.mark.parametrize("name", [slow(name) if "resnet" in name else name for name in PUBLISHED])
def test_published_weights_give_the_maps_of_the_published_classifier(name):
    """Oracle: torchvision's network, cut by its own tracing."""
    network = classifier(name)
    body = open_backbone(name, channels=3).eval()
    load_backbone(body, network.state_dict())
    cut = create_feature_extractor(network, NODES[name])
    image = torch.rand(2, 3, 64, 64)
    with torch.no_grad():
        for ours, theirs in zip(body(image), cut(image).values(), strict=True):
            assert torch.equal(ours, theirs)


@pytest.mark.parametrize(
    ("name", "channels"),
    [
        ("mobilenet-v3-small", 1),
        ("mobilenet-v3-small", 5),
        slow("resnet18", 1),
        slow("resnet18", 5),
    ],
)
def test_a_grey_picture_has_the_same_maps_for_any_number_of_channels(name, channels):
    network = classifier(name)
    body = open_backbone(name, channels=channels).eval()
    load_backbone(body, network.state_dict())
    three = open_backbone(name, channels=3).eval()
    load_backbone(three, network.state_dict())
    grey = torch.rand(1, 1, 64, 64)
    with torch.no_grad():
        ours = body(grey.expand(-1, channels, -1, -1))
        theirs = three(grey.expand(-1, 3, -1, -1))
    for a, b in zip(ours, theirs, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4 * float(b.abs().max()))


@pytest.mark.slow
def test_weights_of_another_backbone_are_refused_and_change_nothing():
    body = open_backbone("resnet18", channels=3)
    before = {key: value.clone() for key, value in body.state_dict().items()}
    with pytest.raises(GraycastError, match=r"resnet18: the file has 'layer1\.0\.bn3\.bias'"):
        load_backbone(body, names_of("resnet50"))
    lacks = names_of("resnet18")
    del lacks["layer4.1.conv2.weight"]
    with pytest.raises(GraycastError, match=r"backbone has 'layer4\.1\.conv2\.weight' and the"):
        load_backbone(body, lacks)
    other = names_of("resnet18")
    other["layer4.1.conv2.weight"] = other["layer4.1.conv2.weight"][:, :7]
    with pytest.raises(GraycastError, match=r"the shape \(512, 7, 3, 3\), the backbone's has"):
        load_backbone(body, other)
    assert all(torch.equal(before[key], value) for key, value in body.state_dict().items())


def test_the_error_for_an_unknown_backbone_lists_the_known_backbones():
    with pytest.raises(GraycastError, match="no backbone 'vgg': choose one of mobilenet-v3-small"):
        open_backbone("vgg", channels=3)


def test_darknet_has_the_53_layers_and_parameters_of_the_paper():
    """Oracle: 52 convolutions beside the classifier's; 40 584 928 weights, as published."""
    with torch.device("meta"):
        body = open_backbone("darknet53", channels=3)
    convolutions = [m for m in body.modules() if isinstance(m, torch.nn.Conv2d)]
    assert len(convolutions) == 52
    assert sum(p.numel() for p in body.parameters()) == 40_584_928


@pytest.mark.slow
def test_running_statistics_of_norms_adapt_within_20_steps():
    """After n steps on one picture, the remaining error of the statistics is 0.9^n."""
    body = open_backbone("mobilenet-v3-small", channels=3)
    first = body.features[0][1]
    image = torch.rand(2, 3, 64, 64)
    with torch.no_grad():
        mean = body.features[0][0](image).mean(dim=(0, 2, 3))
        for _ in range(20):
            body(image)
    torch.testing.assert_close(first.running_mean, (1 - 0.9**20) * mean)
