"""The remedies of the hazard table (docs/stress.md), each as the text that takes it away and the test that must then fail.

A mutant is a text replacement in one file of the packages. Its `remedy` must occur there exactly once.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """One remedy, taken away."""

    hazard: str
    """Of the table."""
    file: str
    """From the checkout."""
    remedy: str
    without: str
    test: str
    """Node id of the test that must fail."""


ROTATION, SKINNING, TRIANGLE = (f"avatarrex/ops/{name}.py" for name in ("rotation", "skinning", "triangle"))
INFLUENCE, BODY, LOOPS = "avatarrex/fields/influence.py", "avatarrex/fields/body.py", "avatarrex/fields/loops.py"
RENDERING, SAMPLING = (f"avatarrex/training/core/{name}.py" for name in ("volume_rendering", "sampling"))
ENCODING = "avatarrex/ops/encoding.py"
TESTS_CONTEXT = "tests/gl/test_context.py"
TESTS_ROTATION = "tests/ops/test_rotation.py"
TESTS_RENDERING = "tests/training/test_volume_rendering.py"
TESTS_BODY = "tests/fields/test_body_influence.py"
TESTS_FRAME = "tests/fields/test_local_frame.py"
TESTS_RAYS = "tests/pointmap/test_hazards.py"
THIN = f"{TESTS_RAYS}::test_a_sheet_thinner_than_the_smallest_step_is_never_missed"

MUTANTS: dict[str, Mutant] = {
    "matrix at angle 0": Mutant(
        "axis-angle at 0",
        ROTATION,
        "square_safe = torch.where(small, torch.ones_like(square), square)",
        "square_safe = square",
        f"{TESTS_ROTATION}::test_the_gradient_at_zero_is_the_cross_product",
    ),
    "quaternion at angle 0": Mutant(
        "axis-angle at 0",
        ROTATION,
        "    angle = torch.where(small, torch.ones_like(square), square).sqrt()",
        "    angle = square.sqrt()",
        f"{TESTS_ROTATION}::test_gradients_are_finite_everywhere",
    ),
    "rotvec at angle 0": Mutant(
        "axis-angle at 0",
        ROTATION,
        "    length = torch.where(small, torch.ones_like(square), square).sqrt()",
        "    length = square.sqrt()",
        f"{TESTS_ROTATION}::test_gradients_are_finite_everywhere",
    ),
    "half turns": Mutant(
        "axis-angle at π",
        ROTATION,
        "best = outer.diagonal(dim1=-2, dim2=-1).argmax(-1)",
        "best = torch.zeros(outer.shape[:-2], dtype=torch.long)",
        f"{TESTS_ROTATION}::test_half_turns_come_back_as_the_same_rotation",
    ),
    "inverse without a floor": Mutant(
        "blended skinning matrix",
        SKINNING,
        "weak = determinant * AMPLIFICATION <= adjugate.detach().square().sum((-2, -1)).sqrt()",
        "weak = torch.zeros_like(determinant, dtype=torch.bool)",
        "tests/ops/test_skinning.py::test_the_inverse_of_opposed_twists_is_bounded",
    ),
    "floor without the polar rotation": Mutant(
        "blended skinning matrix",
        SKINNING,
        "inverse: Tensor = (vt.mT @ (u / stretch[:, None, :]).mT).to(linear.dtype)",
        "inverse: Tensor = torch.eye(3).to(linear).expand_as(linear)",
        "tests/ops/test_skinning.py::test_the_inverse_is_continuous_where_the_bound_sets_in",
    ),
    "influence as printed": Mutant(
        "Σw → 0",
        INFLUENCE,
        "return EPSILON * torch.expm1((RADIUS**2 - squared_distance) / (2 * SIGMA**2)).clamp_min(0)",
        "return (torch.exp(-squared_distance / (2 * SIGMA**2)) - EPSILON).clamp_min(0)",
        f"{TESTS_BODY}::test_rim_keeps_its_digits",
    ),
    "sharp elbow, blended matrix": Mutant(
        "sharp joints",
        BODY,
        "linear = blend_rotations(posed.skinning, weights, self.template.parents)",
        "linear = blend(posed.skinning, weights)[:, :, :3]",
        f"{TESTS_FRAME}::test_a_turned_frame_keeps_distances_about_a_sharp_elbow[140]",
    ),
    "half a turn, either way": Mutant(
        "sharp joints",
        "avatarrex/ops/skinning.py",
        "NEARER = (1.0, 0.061, 0.041, 0.023)",
        "NEARER = (1.0, 0.0, 0.0, 0.0)",
        "tests/ops/test_skinning.py::test_which_way_a_half_turn_goes_is_not_a_matter_of_rounding",
    ),
    "sharp elbow, the skin nearby": Mutant(
        "sharp joints",
        "avatarrex/fields/local_frame.py",
        "limb = (height * height.abs() + ASIDE",
        "limb = (height.square() + ASIDE",
        f"{TESTS_FRAME}::test_a_point_in_one_limb_that_touches_another_belongs_to_the_one_it_is_in",
    ),
    "sharp elbow, compiled": Mutant(
        "sharp joints",
        LOOPS,
        "limb = height * abs(height) + aside",
        "limb = height * height + aside",
        f"{TESTS_FRAME}::test_sharply_bent_limbs_of_the_default_person_stay_whole",
    ),
    "sharp elbow, heights over what is buried": Mutant(
        "sharp joints",
        "avatarrex/training/core/supervision.py",
        "known = (guess <= 0) | (winding(SearchTree.of_triangles(mesh, faces.numpy()), position) <= 0)",
        "known = guess < np.inf",
        "tests/training/test_warm_start.py::test_points_over_one_limb_and_within_another_are_left_out",
    ),
    "hand on the hip": Mutant(
        "limbs that touch",
        BODY,
        "kept = torch.nonzero(~self.replaced.cpu()[sampled])[:, 0]",
        "kept = torch.arange(len(sampled))",
        "tests/volume/test_composed_field.py::test_cloth_beneath_a_hand_maps_to_the_trunk_at_rest",
    ),
    "limbs split at once": Mutant(
        "limbs that touch",
        "avatarrex/volume/contact.py",
        "return (depth.amin(-1) / FADE).clamp(0, 1)",
        "return (depth.amin(-1) >= 0).to(local)",
        "tests/volume/test_composed_field.py::test_nothing_jumps_at_the_faces_of_a_hands_box",
    ),
    "flat fingers in the belly": Mutant(
        "limbs that touch",
        "avatarrex/fields/body_without_hands.py",
        "sdf = sdf.index_copy(0, rows, sdf[rows].minimum(others))",
        "assert len(others)",
        "tests/volume/test_composed_field.py::test_the_templates_fingers_carve_no_cloth",
    ),
    "colour of the limb above": Mutant(
        "limbs that touch",
        "avatarrex/shading/colour.py",
        "frame = self.body_frame.restricted(nodes_of(self.avatar.ownership, limb))",
        "frame = self.body_frame",
        "tests/shading/test_colour.py::test_what_an_arm_touches_is_coloured_without_the_arm",
    ),
    "fingers in the palm": Mutant(
        "a hand that pierces itself",
        "avatarrex/fields/hand.py",
        "torch.where(within, -sdf[unsure].abs(), sdf[unsure].abs().clamp_max(far))",
        "sdf[unsure]",
        "tests/fields/test_hand_field.py::test_what_is_within_a_finger_is_inside_wherever_the_fingers_pierce",
    ),
    "skin that is half buried": Mutant(
        "a hand that pierces itself",
        "avatarrex/fields/hand.py",
        "corner[faces].any(-1) | self._pierced(",
        "self._pierced(",
        "tests/fields/test_hand_field.py::test_a_finger_tip_in_the_middle_of_a_large_face_is_found",
    ),
    "faces that are pierced in the middle": Mutant(
        "a hand that pierces itself",
        "avatarrex/fields/hand.py",
        " | self._pierced(exact[faces], normalize(outward.face, dim=-1))",
        "",
        "tests/fields/test_hand_field.py::test_a_finger_tip_in_the_middle_of_a_large_face_is_found",
    ),
    "skin that nobody sees": Mutant(
        "a hand that pierces itself",
        "avatarrex/parts/hand.py",
        "state.query(points.position, None, impl).facing(points.gaze)",
        "state.query(points.position, None, impl)",
        "tests/shading/test_colour.py::test_the_skin_of_a_fist_that_is_seen_faces_the_eye",
    ),
    "a ray through a corner": Mutant(
        "a hand that pierces itself",
        "avatarrex/ops/crossings.py",
        "return bool((side >= 0) != turned)",
        "return (side <= 0) if turned else (side >= 0)",
        "tests/ops/test_crossings.py::test_rays_through_corners_and_along_walls_are_counted_once",
    ),
    "quaternions of either sign": Mutant(
        "sharp joints",
        SKINNING,
        "sign = 1 - 2 * ((lineage & turned).sum(-1) % 2)",
        "sign = torch.ones_like(quaternion[:, 0])",
        "tests/ops/test_skinning.py::test_half_a_joint_turns_halfway_whatever_turns_before_it",
    ),
    "mean of nothing": Mutant(
        "Σw → 0",
        INFLUENCE,
        "summed / torch.where(reached, total, torch.ones_like(total))[:, None], total",
        "summed / total[:, None], total",
        f"{TESTS_BODY}::test_weighted_mean_of_unreached_points_is_zero_and_flagged[torch]",
    ),
    "mean of nothing, compiled": Mutant(
        "Σw → 0",
        LOOPS,
        "if total[p] > 0:",
        "if total[p] >= 0:",
        f"{TESTS_BODY}::test_weighted_mean_of_unreached_points_is_zero_and_flagged[auto]",
    ),
    "no fill": Mutant(
        "Σw → 0",
        BODY,
        "return torch.where(missed, fill, inside)",
        "return inside",
        "tests/fields/test_body.py::test_far_points_get_the_conservative_fill[anchors]",
    ),
    "fill that ignores the cover": Mutant(
        "Σw → 0",
        BODY,
        "return (nearest.clamp_min(RADIUS) - frame.cover).clamp_min(LEAST_FILL)",
        "return nearest.clamp_min(LEAST_FILL)",
        "tests/fields/test_body.py::test_fill_never_exceeds_the_distance_to_the_surface",
    ),
    "Laplace CDF by cases": Mutant(
        "Laplace CDF",
        RENDERING,
        "return (0.5 + 0.5 * torch.sign(sdf) * torch.expm1(-sdf.abs() / gamma)) / gamma",
        "e = torch.exp\n    return torch.where(sdf > 0, 0.5 * e(-sdf / gamma), 1 - 0.5 * e(sdf / gamma)) / gamma",
        f"{TESTS_RENDERING}::test_density_and_slope_are_finite_far_from_the_surface",
    ),
    "share by 1 − exp": Mutant(
        "transmittance",
        RENDERING,
        "return torch.exp(-before) * -torch.expm1(-depth)",
        "return torch.exp(-before) * (1 - torch.exp(-depth))",
        f"{TESTS_RENDERING}::test_a_whiff_of_fog_keeps_its_digits",
    ),
    "inclusive sum": Mutant(
        "transmittance",
        RENDERING,
        "before = torch.cumsum(depth, -1) - depth",
        "before = torch.cumsum(depth, -1)",
        f"{TESTS_RENDERING}::test_a_slab_absorbs_what_the_formula_says",
    ),
    "one segment of three": Mutant(
        "sliver triangles",
        TRIANGLE,
        "best = torch.minimum(torch.minimum(square_ab, square_ac), square_bc)",
        "best = square_ab",
        "tests/ops/test_triangle.py::test_a_needle_is_its_longest_side",
    ),
    "one segment of three, compiled": Mutant(
        "sliver triangles",
        "avatarrex/ops/closest_triangle.py",
        "best = min(square_ab, square_ac, square_bc)",
        "best = square_ab",
        "tests/ops/test_closest_triangle.py::test_a_needle_is_its_longest_side",
    ),
    "faces without a normal": Mutant(
        "sliver triangles",
        "avatarrex/ops/closest_point.py",
        "        if unsure.any():",
        "        if False:",
        "tests/ops/test_closest_point.py::test_without_the_remedies_dirty_meshes_turn_inside_out",
    ),
    "faces without a normal, compiled": Mutant(
        "sliver triangles",
        "avatarrex/ops/closest_point.py",
        "        sdf[unsure] = torch.where(inside, -1.0, 1.0).to(sdf) * sdf[unsure].abs()",
        "        del inside",
        "tests/ops/test_closest_point.py::test_without_the_remedies_dirty_meshes_turn_inside_out",
    ),
    "vertices at one place, compiled": Mutant(
        "sliver triangles",
        "avatarrex/ops/pseudonormal_loops.py",
        "joined[v] = table[slot]",
        "joined[v] = v",
        "tests/ops/test_closest_triangle.py::test_compiled_pseudonormals_are_those_in_torch",
    ),
    "a row of points that nears the surface": Mutant(
        "sides not searched",
        "avatarrex/ops/closest_triangle.py",
        "        if p > begin:\n            clear -=",
        "        if p < begin:\n            clear -=",
        "tests/ops/test_closest_triangle.py::test_a_row_of_points_that_leaves_the_bound_and_comes_back",
    ),
    "vertices at one place": Mutant(
        "sliver triangles",
        "avatarrex/ops/pseudonormal.py",
        "place, welded = torch.unique(vertices, dim=0, return_inverse=True)",
        "place, welded = vertices, torch.arange(len(vertices))",
        "tests/ops/test_closest_triangle.py::test_compiled_pseudonormals_are_those_in_torch",
    ),
    "one raycast pass, torch": Mutant(
        "thin parts",
        "avatarrex/pointmap/raycast_torch.py",
        "t[again] = first_crossing(volume, plane.rays(pixels[again].double())).float()",
        "del again",
        f"{THIN}[torch]",
    ),
    "one raycast pass, GL": Mutant(
        "thin parts",
        "avatarrex/pointmap/raycast_gl.py",
        "*traced, *exact]",
        "*traced]",
        f"{THIN}[gl]",
    ),
    "beams as wide as their middle": Mutant(
        "rays that share a beam",
        "shaders/pointmap/beams.comp",
        "const float WIDE = 11;",
        "const float WIDE = 1;",
        "tests/pointmap/test_beams.py::test_a_rod_is_found_wherever_it_lies_in_a_tile",
    ),
    "beams that trust what is stored": Mutant(
        "rays that share a beam",
        "shaders/pointmap/beams.comp",
        "max(sdf / STEEP, sdf - TRUSTED) - width",
        "abs(sdf) - width",
        "tests/pointmap/test_beams.py::test_a_steep_field_is_not_stepped_through",
    ),
    "tiles beside what is cast": Mutant(
        "rays that share a beam",
        "avatarrex/pointmap/raycast_gl.py",
        "for y, x in ((0, 1), (1, 0), (1, 1), (1, 2), (2, 1)):",
        "for y, x in ((1, 1),):",
        "tests/pointmap/test_kept_hits.py::test_pixels_beside_what_is_chosen_for_are_cast_too",
    ),
    "tiles that nobody has written": Mutant(
        "rays that share a beam",
        "shaders/pointmap/edges.comp",
        "    if (beam_of(pixel) == EMPTY) return found;",
        "",
        "tests/pointmap/test_beams.py::test_a_picture_after_a_larger_one_holds_nothing_of_it",
    ),
    "small components in the air": Mutant(
        "small components",
        "avatarrex/volume/build.py",
        "grid if settings.everywhere else without_small_components(grid)",
        "grid",
        "tests/volume/test_small_components.py::test_levels_have_none_but_the_papers[False]",
    ),
    "small components that are joined": Mutant(
        "small components",
        "avatarrex/volume/small_components.py",
        "return not np.isin(at_voxels[(there > 0) & (there != label)], own).any()",
        "return True",
        "tests/volume/test_small_components.py::test_what_interpolation_joins_to_the_body_stays",
    ),
    "hollow flesh": Mutant(
        "small components",
        "avatarrex/fields/template_distance.py",
        "for side in (-1, AIR))",
        "for side in (-1, 1))",
        "tests/fields/test_template_distance.py::test_a_field_may_stand_off_farther_than_it_may_be_hollow",
    ),
    "parallel rays, torch": Mutant(
        "parallel rays",
        "avatarrex/pointmap/rays.py",
        "safe = torch.where(direction.abs() < 1e-12, 1e-12, direction)",
        "safe = direction",
        f"{TESTS_RAYS}::test_the_slab_test_survives_zero_components",
    ),
    "parallel rays, GLSL": Mutant(
        "parallel rays",
        "shaders/lib/slab.glsl",
        "vec3 safe = mix(direction, vec3(1e-12), lessThan(abs(direction), vec3(1e-12)));",
        "vec3 safe = direction;",
        f"{TESTS_RAYS}::test_the_shaders_slab_test_survives_zero_components",
    ),
    "difference in float32": Mutant(
        "far from origin",
        "avatarrex/camera.py",
        "self.camera_from_world @ world_from_root,",
        "self.camera_from_world.astype(np.float32) @ world_from_root.astype(np.float32),",
        "tests/pointmap/test_raycast.py::test_a_root_a_kilometre_away_gives_the_same_image[gl]",
    ),
    "rays from the camera": Mutant(
        "far from origin",
        "avatarrex/pointmap/rays.py",
        "depth = max(float(camera.camera_from_world[2] @ np.append(centre, 1.0)), NEAREST_PLANE)",
        "depth = NEAREST_PLANE",
        "tests/pointmap/test_raycast.py::test_a_camera_a_kilometre_away_is_as_exact[gl]",
    ),
    "encoding without a clamp": Mutant(
        "encoding",
        ENCODING,
        "rows = x.T.clamp(-limit, limit)",
        "rows = x.T",
        "tests/ops/test_encoding.py::test_far_points_are_clamped",
    ),
    "encoding of half coordinates": Mutant(
        "encoding",
        ENCODING,
        "rows = x.T.clamp(-limit, limit)",
        "rows = x.T.clamp(-limit, limit).half().to(x.dtype)",
        "tests/ops/test_encoding.py::test_recurrence_follows_the_equation",
    ),
    "encoding of unscaled places": Mutant(
        "encoding",
        BODY,
        "local = take(rest, pairs.point) - take(frame.node_rest, pairs.node)",
        "local = take(rest, pairs.point)",
        "tests/fields/test_body.py::test_local_frames_agree_at_rest",
    ),
    "bf16 storage": Mutant(
        "storage",
        "avatarrex/avatar_file.py",
        "name: value.half() if half and",
        "name: value.bfloat16() if half and",
        "tests/test_avatar.py::test_round_trip_keeps_the_weights[copy.avatar]",
    ),
    "reach of what moved": Mutant(
        "temporal reuse",
        "avatarrex/volume/temporal_reuse.py",
        "(self.nodes, RADIUS)",
        "(self.nodes, RADIUS / 4)",
        "tests/volume/test_temporal_reuse.py::test_the_grid_is_the_one_that_the_reused_state_gives",
    ),
    "a lattice that grew": Mutant(
        "temporal reuse",
        "avatarrex/volume/body_grid.py",
        "kept is not None and kept.grid.voxel != lattice.voxel",
        "kept is not None and kept.grid is None",
        "tests/volume/test_temporal_reuse.py::test_a_lattice_that_grew_takes_nothing_over",
    ),
    "ends of the band in half precision": Mutant(
        "storage",
        "avatarrex/parts/hand.py",
        "BOUND = (-CLAMP, 0.026)",
        "BOUND = (-0.05, 0.025)",
        "tests/volume/test_narrow_band.py::test_the_hand_box_has_the_signs_and_near_values_of_the_exact_distance",
    ),
    "samples that all lie outside": Mutant(
        "surfaces that creep",
        SAMPLING,
        "drawn = count - enters.long()",
        "drawn = count",
        "tests/training/test_sampling.py::test_the_losses_are_least_at_the_true_surface",
    ),
    "silhouettes that only push": Mutant(
        "surfaces that creep",
        "avatarrex/training/core/losses.py",
        "off = torch.where(matte > 1 - PURE, off.clamp_max(0), torch.where(matte < PURE, off.clamp_min(0), off))",
        "off = torch.where(matte > 1 - PURE, off.clamp_max(0), off)",
        f"{TESTS_RENDERING}::test_a_silhouette_is_right_within_its_pixels",
    ),
    "a part partly off screen": Mutant(
        "parts off screen",
        "avatarrex/volume/off_screen.py",
        "bool((side < 0).all())",
        "bool((side < 0).any())",
        "tests/volume/test_off_screen.py::test_a_part_partly_on_screen_is_built",
    ),
    "inside another program's context": Mutant(
        "contexts of others",
        "avatarrex/gl/context.py",
        "if not switch(before, known.binding):",
        "if False:",
        f"{TESTS_CONTEXT}::test_work_goes_on_inside_another_program_and_leaves_its_context_current",
    ),
    "keeping the thread": Mutant(
        "contexts of others",
        "avatarrex/gl/context.py",
        "            switch(known.binding, before)",
        "            pass",
        f"{TESTS_CONTEXT}::test_work_goes_on_inside_another_program_and_leaves_its_context_current",
    ),
}
