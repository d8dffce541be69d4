"""Sabotage of the training, each as a text replacement and the test that must then fail (docs/training.md).

Weights, schedules and terms by the table and closed forms, in seconds; what a training does by the first milestone that it
misses.
"""

from __future__ import annotations

from mutations.mutants import Mutant

CORE, READERS = "avatarrex/training/core", "avatarrex/capture/readers"
LEARNS = "tests/training/test_learning.py::test_a_perturbed_avatar_learns_what_was_held_out"
PATCHES = "tests/training/test_learning.py::test_patches_teach_what_nobody_painted"
PASS_TWO = "tests/training/test_pass_two.py"
COMPARED = f"{PASS_TWO}::test_who_knows_the_pattern_has_nothing_to_learn_from_patches"
PAINTED = f"{PASS_TWO}::test_pictures_are_painted_where_they_are_seen"
DROPPED = f"{PASS_TWO}::test_dropped_views_are_kept_from_networks_and_not_from_texels[True]"
PAPER, TERMS, SEALED = (f"tests/training/test_{name}.py" for name in ("paper", "terms", "sealed"))
PATHS = f"{SEALED}::test_no_path_of_a_training_reads_what_is_not_in_its_split"
WEIGHTS = {
    "I weights.mask": "1.0",
    "I weights.eikonal": "2.0",
    "I weights.node": "0.04",
    "I weights.embedding": "0.01",
    "I weights.kl": "1e-6",
    "II weights.perceptual": "1.0",
}
"""λ by its line of the table, as the recipe writes it."""


def _weight(line: str, value: str, factor: float) -> Mutant:
    """A λ times `factor`."""
    stated, test = f"    {line.split('.')[1]}: float = {value}\n", f"{PAPER}::test_paper_is_the_papers[{line}]"
    changed = stated.replace(value, f"{factor} * {value}")
    return Mutant("numbers of the paper", "avatarrex/training/recipe.py", stated, changed, test)


LEARNING: dict[str, Mutant] = {
    "ascent": Mutant(
        "what is learnt",
        f"{CORE}/work.py",
        "torch.autograd.backward(total)",
        "torch.autograd.backward(-total)",
        f"{LEARNS}[body]",
    ),
    "zero rate": Mutant(
        "what is learnt", f"{CORE}/work.py", 'group["lr"] = rate', 'group["lr"] = 0.0', f"{LEARNS}[body]"
    ),
    "a pass II that learns nothing": Mutant(
        "what is learnt",
        f"{CORE}/stage.py",
        "return rate, one.texel_rate * rate, rate",
        "return 0.0, 0.0, 0.0",
        f"{PATCHES}[body]",
    ),
    "patches shuffled": Mutant(
        "what is learnt",
        f"{CORE}/pass_two.py",
        "self._compare(rendered * both, truth * both, both)",
        "self._compare(rendered * both, truth.flip(0, 1) * both, both)",
        f"{PATCHES}[face]",
    ),
    "wrong camera": Mutant(
        "what is learnt",
        f"{CORE}/pass_one.py",
        "camera = frame.camera(rig.views[view].camera)",
        "camera = frame.camera(rig.views[0].camera)",
        f"{LEARNS}[body]",
    ),
    "colours in linear light": Mutant(
        "what is learnt",
        f"{CORE}/pixels.py",
        "colour = rig.image(view, frame)[y, x].astype(np.float32) / 255 * alpha[:, None]",
        "colour = (rig.image(view, frame)[y, x].astype(np.float32) / 255) ** 2.2 * alpha[:, None]",
        f"{LEARNS}[body]",
    ),
    "mattes inverted": Mutant(
        "what is learnt",
        f"{CORE}/pixels.py",
        "alpha = rig.matte(view, frame)[y, x].astype(np.float32) / 255",
        "alpha = 1 - rig.matte(view, frame)[y, x].astype(np.float32) / 255",
        f"{LEARNS}[body]",
    ),
    "no images at all": Mutant(
        "what is learnt",
        f"{CORE}/pixels.py",
        "colour = rig.image(view, frame)[y, x].astype(np.float32) / 255 * alpha[:, None]",
        "colour = 0 * rig.image(view, frame)[y, x].astype(np.float32) / 255 * alpha[:, None]",
        f"{LEARNS}[body]",
    ),
    "wrong camera for patches": Mutant(
        "what is learnt",
        f"{CORE}/pass_two.py",
        "camera = rig.views[view].camera\n        x, y,",
        "camera = rig.views[0].camera\n        x, y,",
        COMPARED,
    ),
    "patches of another place": Mutant(
        "what is learnt",
        f"{CORE}/pass_two.py",
        "camera.cropped(x, y, width, height)",
        "camera.cropped(0, 0, width, height)",
        COMPARED,
    ),
    "patches in linear light": Mutant(
        "what is learnt",
        f"{CORE}/pass_two.py",
        "return Patch(rendered, truth, both,",
        "return Patch(rendered, truth**2.2, both,",
        COMPARED,
    ),
    "patches without pictures": Mutant(
        "what is learnt",
        f"{CORE}/pass_two.py",
        "return Patch(rendered, truth, both,",
        "return Patch(rendered, 0 * truth, both,",
        COMPARED,
    ),
    "patches in inverted mattes": Mutant(
        "what is learnt",
        f"{CORE}/pass_two.py",
        "both = torch.minimum(coverage, matte)",
        "both = torch.minimum(coverage, 1 - matte)",
        COMPARED,
    ),
    "mattes inverted for every reader": Mutant(
        "what is learnt",
        f"{READERS}/rigs.py",
        'return self._picture("matte", view, frame)',
        'return 255 - self._picture("matte", view, frame)',
        COMPARED,
    ),
    "no images for any reader": Mutant(
        "what is learnt",
        f"{READERS}/rigs.py",
        'return self._picture("image", view, frame)',
        'return 0 * self._picture("image", view, frame)',
        PAINTED,
    ),
    "painted by the wrong camera": Mutant(
        "what is learnt",
        f"{CORE}/projection.py",
        "camera = frame.camera(rig.views[view].camera)",
        "camera = frame.camera(rig.views[0].camera)",
        PAINTED,
    ),
    "painted in linear light": Mutant(
        "what is learnt",
        f"{CORE}/projection.py",
        "raycast(frame.volume.sdf, camera, antialias=True), colour, matte)",
        "raycast(frame.volume.sdf, camera, antialias=True), colour**2.2, matte)",
        PAINTED,
    ),
    "views that are not dropped": Mutant(
        "what is learnt",
        f"{CORE}/pass_two.py",
        "gaze = _anywhere(rng) if rng.random() < self.recipe.view_dropout else None",
        "gaze = None",
        DROPPED,
    ),
    "views dropped to one side": Mutant(
        "what is learnt",
        f"{CORE}/pass_two.py",
        "drawn = rng.normal(size=3)",
        "drawn = rng.random(size=3)",
        f"{PASS_TWO}::test_views_are_dropped_as_often_as_wanted_and_turned_anywhere",
    ),
    "a dropped view that the body sees": Mutant(
        "what is learnt",
        "avatarrex/shading/colour.py",
        "return direction if self.told is None else self.told.to(direction).expand_as(direction)",
        "return direction",
        DROPPED,
    ),
    "a dropped view that the face sees": Mutant(
        "what is learnt",
        "avatarrex/shading/colour.py",
        "direction = gaze if told is None else told.to(gaze).expand_as(gaze)",
        "direction = gaze",
        DROPPED,
    ),
    "hands that face a dropped view": Mutant(
        "what is learnt",
        "avatarrex/parts/hand.py",
        ".facing(points.gaze)",
        ".facing(points.direction)",
        DROPPED,
    ),
    "teeth looked for along a dropped view": Mutant(
        "what is learnt",
        "avatarrex/parts/face.py",
        "places = self._places(state, trained, normal, points.gaze)",
        "places = self._places(state, trained, normal, points.direction)",
        DROPPED,
    ),
    "geometry that stands still": Mutant(
        "what is learnt",
        f"{CORE}/stage.py",
        "0.0 if step - self.begin < one.still else one.geometry_rate * rate",
        "0.0",
        f"{LEARNS}[face]",
    ),
    "γ frozen": Mutant(
        "numbers of the paper",
        f"{CORE}/volume_rendering.py",
        "max(0.0, 1 - step / self.steps)",
        "1.0",
        f"{PAPER}::test_gamma_falls_as_the_paper_says",
    ),
    "a rate that does not decay": Mutant(
        "numbers of the paper",
        f"{CORE}/stage.py",
        "float(self.recipe.decay ** ((step - self.begin) / self.recipe.decay_steps))",
        "float(self.recipe.decay > 0)",
        f"{PAPER}::test_rates_decay_by_one_factor_every_20k",
    ),
    **{f"{line}, halved": _weight(line, value, 0.5) for line, value in WEIGHTS.items()},
    **{f"{line}, dropped": _weight(line, value, 0.0) for line, value in WEIGHTS.items()},
    "a hundredth of the paper's steps": Mutant(
        "numbers of the paper",
        "avatarrex/training/recipe.py",
        "    steps=200_000, frames=4,",
        "    steps=2_000, frames=4,",
        f"{PAPER}::test_paper_is_the_papers[I steps]",
    ),
    "nodes pulled ten times as much": Mutant(
        "numbers of the paper",
        "avatarrex/training/recipe.py",
        "weights=LossWeights(silhouette=1.0, node=1.0),",
        "weights=LossWeights(silhouette=1.0, node=10.0),",
        f"{PAPER}::test_weights_of_other_recipes_are_the_papers_but_for_ours[quick]",
    ),
    "a stranger's face by its mesh": Mutant(
        "what is learnt",
        f"{CORE}/pass_one.py",
        "if not self.recipe.weights.skin or not person.own_face:",
        "if not self.recipe.weights.skin:",
        "tests/training/test_known_face.py::test_only_a_known_face_is_compared",
    ),
    "what lids hide at rest by its mesh": Mutant(
        "what is learnt",
        f"{CORE}/pass_one.py",
        "hidden_at_rest(face, template.v_template.to(face.box_centre)) | template.mouth",
        "template.mouth",
        "tests/training/test_known_face.py::test_what_can_be_seen_is_compared_and_nothing_within_lips",
    ),
    "labels where a fitted face lies": Mutant(
        "what is learnt",
        "avatarrex/templates/person.py",
        "if fit.labels_stay and (face",
        "if False and (face",
        "tests/templates/test_face_labels.py::test_labels_are_the_templates_vertices",
    ),
    "the mouth by its mesh": Mutant(
        "what is learnt",
        f"{CORE}/pass_one.py",
        "hidden_at_rest(face, template.v_template.to(face.box_centre)) | template.mouth",
        "hidden_at_rest(face, template.v_template.to(face.box_centre))",
        "tests/training/test_known_face.py::test_what_can_be_seen_is_compared_and_nothing_within_lips",
    ),
    "eyes by vertices alone": Mutant(
        "what is learnt",
        f"{CORE}/pass_one.py",
        "[chosen], self._seen_of_eyes(frame)])",
        "[chosen]])",
        "tests/training/test_known_face.py::test_about_eyes_is_compared_what_the_front_shows",
    ),
    "weights without effect": Mutant(
        "numbers of the paper",
        f"{CORE}/losses.py",
        "getattr(weights, name) * value",
        "value",
        f"{PAPER}::test_weights_multiply_their_terms",
    ),
    "slopes of nothing": Mutant(
        "what is learnt",
        f"{CORE}/losses.py",
        "(slope.norm(dim=-1) - 1).square()",
        "slope.norm(dim=-1).square()",
        f"{TERMS}::test_slopes_are_pulled_to_one",
    ),
    "texels in another order": Mutant(
        "what is learnt",
        "avatarrex/fields/loops.py",
        "share[p, 0], share[p, 1], share[p, 2] = scale * a, scale * b, scale * c",
        "share[p, 0], share[p, 1], share[p, 2] = scale * b, scale * a, scale * c",
        "tests/fields/test_detail_texture.py::test_what_is_linear_is_given_back[0.02]",
    ),
    "detail painted on what stands off": Mutant(
        "what is learnt",
        "avatarrex/fields/loops.py",
        "scale = min(max((off[1] - away) / (off[1] - off[0]), 0.0), 1.0) / total",
        "scale = 1.0 / total",
        "tests/fields/test_detail_texture.py::test_detail_fades_out_off_the_surface",
    ),
    "teeth looked for along the normal": Mutant(
        "what is learnt",
        "avatarrex/parts/face.py",
        "back = -gaze.detach().double().cpu().numpy()[beside]",
        "back = normals[beside]",
        "tests/fields/test_face_detail.py::test_past_open_lips_is_seen_what_lies_behind",
    ),
    "a plain mean of the pictures": Mutant(
        "what is learnt",
        f"{CORE}/projection.py",
        "weight = weight / (1 + away / STRAY**2).square()",
        "weight = weight / (1 + 0 * away).square()",
        "tests/training/test_projection.py::test_what_moved_over_a_texel_does_not_count",
    ),
    "texels that follow nobody": Mutant(
        "what is learnt",
        f"{CORE}/agreement.py",
        "(tie * laplacian(pairs, len(mean))",
        "(0 * tie * laplacian(pairs, len(mean))",
        "tests/training/test_agreement.py::test_what_no_picture_shows_is_continued",
    ),
    "edges met in the wrong sense": Mutant(
        "what is learnt",
        "avatarrex/fields/texel_neighbours.py",
        "there = np.where(turned, beyond - there, there)",
        "there = np.where(turned, there, there)",
        "tests/fields/test_texel_neighbours.py::test_equal_lattices_meet_at_their_edge",
    ),
    "ears that are evened out as far as their border": Mutant(
        "what is learnt",
        f"{CORE}/even.py",
        "found[some] += share[some, None] * (mean - albedo[some])",
        "found[some] = mean",
        "tests/training/test_even.py::test_at_the_border_of_a_fold_texels_go_as_far_as_their_corners_moved",
    ),
    "a face whose tone is learnt without it": Mutant(
        "what is learnt",
        f"{CORE}/trainer.py",
        "kept = self.avatar.tone.parameters() if self.keeps_tone else ()",
        "kept = ()",
        "tests/training/test_train.py::test_a_body_that_goes_on_leaves_the_faces_tone_alone[True]",
    ),
    "texels that all move alike": Mutant(
        "what is learnt",
        f"{CORE}/texel_descent.py",
        '/ size * state["mean"]',
        '* state["mean"].sign()',
        "tests/training/test_texel_descent.py::test_a_weak_slope_moves_little",
    ),
    "mattes that explain nothing": Mutant(
        "what is learnt",
        f"{CORE}/carving.py",
        "seed[place] = (inside >= INSIDE) & (unexplained >= UNEXPLAINED)",
        "seed[place] = inside >= INSIDE",
        "tests/training/test_projection.py::test_a_bun_is_carved_and_skin_is_not",
    ),
    "a tail that mixes with the back": Mutant(
        "what is learnt",
        "avatarrex/fields/body.py",
        "gate_rest[len(sampled) :, 0] += APART",
        "pass",
        "tests/fields/test_outgrowth.py::test_the_skin_beneath_it_keeps_its_own",
    ),
    "an outgrowth that stays behind": Mutant(
        "what is learnt",
        "avatarrex/fields/outgrowth.py",
        'np.einsum("pji,pj->pi", self.turn[by], position[rows] - self.posed[by])',
        "(position[rows] - self.posed[by])",
        "tests/fields/test_outgrowth.py::test_the_ball_moves_with_the_skin_beneath_it",
    ),
    "a training that is not sealed": Mutant(
        "sealed data",
        f"{CORE}/trainer.py",
        'self.capture, self.validation = sealed(capture, "train"), sealed(capture, "validation")',
        'self.capture, self.validation = capture, sealed(capture, "validation")',
        PATHS,
    ),
    "figures of the test while training": Mutant(
        "sealed data",
        f"{CORE}/trainer.py",
        'self.capture, self.validation = sealed(capture, "train"), sealed(capture, "validation")',
        'self.capture, self.validation = sealed(capture, "train"), capture',
        PATHS,
    ),
    "a person fitted to what is held out": Mutant(
        "sealed data",
        "avatarrex/capture/fit/outlines.py",
        "        train = Splits.of(rig).train\n",
        "        train = type(Splits.of(rig).train)(tuple(range(len(rig.signals))), tuple(range(len(rig.views))))\n",
        PATHS,
    ),
    "pictures that are not sealed": Mutant(
        "sealed data",
        f"{READERS}/splits.py",
        '            raise Sealed(f"{self._rig} rig, {kind} of view {view}, frame {frame}: not in this split")',
        "            pass",
        f"{SEALED}::test_what_a_sealed_rig_does_not_show_raises",
    ),
}
