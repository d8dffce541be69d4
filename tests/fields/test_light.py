"""The light that turns with nothing: limbs turn in it."""

from __future__ import annotations

import json
import zipfile

import numpy as np
import pytest
import safetensors.torch
import torch
from scipy.spatial.transform import Rotation

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.capture.synthetic.shade import studio_light
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.fields.light import DARKEST, Irradiance, Light
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import pose_person
from avatarrex.volume.build import body_frame


def directions(count: int) -> torch.Tensor:
    """Unit vectors all around."""
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(2)), dim=-1)


def test_a_light_that_is_not_trained_changes_nothing():
    assert torch.equal(Light()(directions(9)), torch.ones(9, 3))


def test_nine_harmonics_contain_the_studio_light():
    """Of a grey surface, to 2.5 % of its brightness in the mean: what a training is to find can be said."""
    normal = directions(4000)
    one = np.ones(len(normal))
    truth = studio_light(0.6 * np.ones((len(normal), 3)), normal.double().numpy(), one, np.zeros(len(normal)))
    light, albedo = Light(), torch.nn.Parameter(torch.full((3,), 0.5))
    optimiser = torch.optim.Adam([*light.parameters(), albedo], lr=0.02)
    wanted = torch.as_tensor(truth).float()
    for _ in range(300):
        optimiser.zero_grad()
        loss = (albedo * light(normal) - wanted).abs().mean()
        loss.backward()
        optimiser.step()
    assert float(loss.detach()) < 0.025 * float(wanted.mean())
    assert float((wanted - wanted.mean(0)).abs().mean()) > 0.1 * float(wanted.mean()), "one colour would not do"


def test_a_light_of_the_world_stands_still_when_the_person_turns():
    normal, world = directions(500), np.eye(4)
    world[:3, :3] = Rotation.from_rotvec([0.3, 1.2, -0.4]).as_matrix()
    light, along = Light("world").requires_grad_(False), Light("root")
    drawn = torch.Generator().manual_seed(3)
    light.add_face()
    for harmonics in (light.harmonics, light.face):
        torch.nn.init.normal_(harmonics, 0.0, 0.3, generator=drawn)
    along.load_state_dict(light.state_dict())
    turned = normal @ torch.as_tensor(world[:3, :3]).float().T
    torch.testing.assert_close(light.over(world)(normal), light(turned), atol=1e-5, rtol=0)
    assert float((light(turned) - light(normal)).abs().mean()) > 0.1
    assert torch.equal(along.over(world)(normal), light(normal))
    faces = light.over(world).on_face(normal)
    torch.testing.assert_close(faces, along.over(world).on_face(turned), atol=1e-5, rtol=0)
    assert float((faces - light.over(world)(normal)).abs().mean()) > 0.1, "the face's rig has lamps of its own"
    assert torch.allclose(light.over(np.eye(4)).harmonics, light.harmonics, atol=1e-6)


def test_an_avatar_says_where_its_light_is_fixed(tmp_path):
    avatar = Avatar.create(load_person(), "compact")
    assert avatar.light.frame == "root"
    avatar.light.frame = "world"
    save_avatar(avatar, tmp_path / "new")
    assert load_avatar(tmp_path / "new").light.frame == avatar.frozen_copy().light.frame == "world"
    meta = json.loads((tmp_path / "new/avatar.json").read_text())
    for wrong in ("sky", 3):
        (tmp_path / "new/avatar.json").write_text(json.dumps(meta | {"light_frame": wrong}))
        with pytest.raises(InputError, match="light_frame"):
            load_avatar(tmp_path / "new")
    meta.pop("light_frame")
    (tmp_path / "new/avatar.json").write_text(json.dumps(meta))
    assert load_avatar(tmp_path / "new").light.frame == "root", "of before there was a choice"


def test_a_light_differs_where_the_faces_does():
    drawn = torch.randn(2, 8, 3, generator=torch.Generator().manual_seed(5))
    one, bare = Irradiance(drawn[0], drawn[1]), Irradiance(drawn[0])
    assert one.same(Irradiance(drawn[0].clone(), drawn[1].clone()))
    assert not one.same(Irradiance(drawn[0], drawn[0]))
    assert not one.same(bare)
    assert not bare.same(one)
    assert bare.same(Irradiance(drawn[0].clone()))
    assert torch.equal(bare.on_face(directions(9)), torch.ones(9, 3))


def test_avatars_of_before_have_no_light_on_their_faces(tmp_path):
    avatar = Avatar.create(load_person(), "compact")
    save_avatar(avatar, tmp_path / "old")
    assert load_avatar(tmp_path / "old").light.face is None
    avatar.light.add_face()
    torch.nn.init.constant_(avatar.light.face, 0.25)
    avatar.light.add_face()
    save_avatar(avatar, tmp_path / "new")
    face = load_avatar(tmp_path / "new").light.face
    assert torch.equal(face, avatar.light.face)
    assert not face.requires_grad
    assert torch.equal(avatar.frozen_copy().light.face, face)
    state = safetensors.torch.load((tmp_path / "new/weights.safetensors").read_bytes())
    state["light.face"] = state["light.face"][:7]
    (tmp_path / "new/weights.safetensors").write_bytes(safetensors.torch.save(state))
    with pytest.raises(InputError, match=r"light\.face"):
        load_avatar(tmp_path / "new")
    avatar.light.load_state_dict({"harmonics": avatar.light.harmonics})
    assert avatar.light.face is None, "a checkpoint of before"


def test_it_never_goes_out():
    light = Light()
    torch.nn.init.constant_(light.harmonics, -3.0)
    assert float(light(directions(500)).detach().min()) == np.float32(DARKEST)


def test_an_arm_faces_where_it_is_turned():
    avatar = Avatar.create(load_person(), "compact")

    def posed(name: str) -> tuple[torch.Tensor, torch.Tensor]:
        person = pose_person(avatar.person, Signals.rest().replace(body_pose=named_pose(name)), Counters(), None)
        samples = body_frame(avatar, person).samples
        assert samples is not None
        return samples.facing(samples.neighbours_of(samples.position)), samples.outward

    (down, own), (up, _) = posed("stand"), posed("arms_up")
    assert float((down * own).sum(-1).median()) > 0.95, "smooth, and the surface's"
    assert torch.allclose(down.norm(dim=-1), torch.ones(len(down)), atol=1e-5)
    turned = (down * up).sum(-1)
    assert (turned < 0.2).sum() > 100, "arms"
    assert float(turned.median()) > 0.9, "the rest stands"


def test_an_avatar_of_format_2_has_none_and_free_codes(tmp_path):
    avatar = Avatar.create(load_person(), "compact")
    torch.nn.init.constant_(avatar.light.harmonics, 0.25)
    save_avatar(avatar, tmp_path / "new.avatar")
    assert torch.equal(load_avatar(tmp_path / "new.avatar").light.harmonics, avatar.light.harmonics)
    with zipfile.ZipFile(tmp_path / "new.avatar") as archive:
        meta = json.loads(archive.read("avatar.json"))
        state = safetensors.torch.load(archive.read("weights.safetensors"))
    newer = ("light.", "body.code_network.least", "body.code_network.most")
    old = {name: value for name, value in state.items() if not name.startswith(newer)}
    assert len(old) == len(state) - 3
    with zipfile.ZipFile(tmp_path / "old.avatar", "w") as archive:
        archive.writestr("avatar.json", json.dumps(meta | {"format": 2}))
        archive.writestr("weights.safetensors", safetensors.torch.save(old))
    before = load_avatar(tmp_path / "old.avatar")
    assert float(before.light.harmonics.abs().max()) == 0
    assert float(before.body.code_network.least.max()) == -1.0, "and codes are free"
    assert float(before.body.code_network.most.min()) == 1.0
