"""Which feature pixels show a road user: those whose known depth puts them inside a labelled box."""

from __future__ import annotations

import torch
from torch import Tensor

MARGIN_M = 0.2  # a box is grown by this much at its sides and top: depths are read once per pixel block
FLOOR_M = 0.1  # and loses this much at the bottom, where it stands on the floor


def back_project(depth: Tensor, agent_to_cam: Tensor, cam_to_img: Tensor, stride: int) -> Tensor:
    """Points (B, h, w, 3) in the agent frame seen at the centres of feature pixels.

    depth (B, h, w) metres along the optical axis; agent_to_cam (B, 4, 4); cam_to_img (B, 3, 4), whose fourth column
    is zero; a feature pixel covers stride x stride image pixels.
    """
    _, h, w = depth.shape
    v, u = torch.meshgrid(
        (torch.arange(h, device=depth.device) + 0.5) * stride,
        (torch.arange(w, device=depth.device) + 0.5) * stride,
        indexing="ij",
    )
    pixels = torch.stack([u, v, torch.ones_like(u)], -1).to(depth.dtype)
    inverse = torch.linalg.inv(cam_to_img[:, :, :3].to(depth.dtype))
    camera = torch.einsum("bij,hwj->bhwi", inverse, pixels) * depth[..., None]
    agent_from_cam = torch.linalg.inv(agent_to_cam.to(depth.dtype))
    return torch.einsum("bij,bhwj->bhwi", agent_from_cam[:, :3, :3], camera) + agent_from_cam[:, None, None, :3, 3]


def inside_boxes(points: Tensor, boxes: Tensor, margin: float = MARGIN_M) -> Tensor:
    """Mask (B, ...) of points (B, ..., 3) inside any of the boxes (B, M, >=7); rows of zeros are padding."""
    flat = points.flatten(1, -2)
    inside = torch.zeros(flat.shape[:2], dtype=torch.bool, device=points.device)
    for m in range(boxes.shape[1]):  # one box at a time: M is small, and (B, P, M, 3) would not be
        x, y, z, dx, dy, dz, heading = boxes[:, m, None, :7].unbind(-1)
        ox, oy = flat[..., 0] - x, flat[..., 1] - y
        cos, sin = torch.cos(heading), torch.sin(heading)
        along, across = ox * cos + oy * sin, oy * cos - ox * sin
        above = flat[..., 2] - z + dz / 2
        hit = (along.abs() <= dx / 2 + margin) & (across.abs() <= dy / 2 + margin)
        inside |= hit & (above > FLOOR_M) & (above <= dz + margin) & (dx > 0)
    return inside.view(points.shape[:-1])


def foreground_mask(
    depth: Tensor, agent_to_cam: Tensor, cam_to_img: Tensor, stride: int, boxes: Tensor, ego_from_agent: Tensor | None
) -> Tensor:
    """(B, h, w) bool. ``boxes`` (B, M, >=7) are in the ego frame; None for the pose means the agent is the ego."""
    points = back_project(depth, agent_to_cam, cam_to_img, stride)
    if ego_from_agent is not None:
        pose = ego_from_agent.to(points.dtype)
        points = torch.einsum("bij,bhwj->bhwi", pose[:, :3, :3], points) + pose[:, None, None, :3, 3]
    return inside_boxes(points, boxes) & (depth > 0)
