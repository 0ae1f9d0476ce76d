//! Which meshes the carrier is made of, in which order, and where each stands.
//!
//! Must not know accessors. Traverses without recursion; a hostile node graph is an error.

use std::collections::HashSet;

use glam::{DAffine3, DMat4, DQuat, DVec3};

use super::document::{Document, Node};
use super::malformed;
use super::transform::Transform;
use crate::formats::FormatError;

/// A mesh at the first place where the scene shows it.
#[derive(Debug)]
pub(super) struct Placed {
    pub(super) mesh: usize,
    pub(super) transform: Transform,
}

/// Meshes in traversal order, depth first; an instanced mesh counts once.
pub(super) fn placed_meshes(document: &Document) -> Result<Vec<Placed>, FormatError> {
    if document.nodes.is_empty() && document.scenes.is_empty() {
        let at_origin =
            |mesh| Transform::new(DAffine3::IDENTITY).map(|transform| Placed { mesh, transform });
        return Ok((0..document.meshes.len()).filter_map(at_origin).collect());
    }
    let is_child = single_parents(document)?;
    let mut stack: Vec<(usize, DAffine3)> = Vec::new();
    for root in roots(document, &is_child)?.into_iter().rev() {
        stack.push((root, DAffine3::IDENTITY));
    }
    let mut placed = Vec::new();
    let mut seen = HashSet::new();
    // The loop ends: every node has at most one parent and roots have none, so no node is visited
    // twice.
    while let Some((index, parent)) = stack.pop() {
        let Some(node) = document.nodes.get(index) else { continue };
        let world = parent * local(node, index)?;
        stack.extend(node.children.iter().rev().map(|&child| (child, world)));
        let Some(mesh) = node.mesh else { continue };
        if mesh >= document.meshes.len() {
            let path = format!("nodes[{index}].mesh");
            return Err(malformed(path, format!("meshes[{mesh}] does not exist")));
        }
        if seen.insert(mesh) {
            // A skinned mesh stands where its joints are: the specification ignores its node.
            let world = if node.skin.is_some() { DAffine3::IDENTITY } else { world };
            let transform = Transform::new(world).ok_or_else(|| FormatError::CannotPatch {
                path: format!("nodes[{index}]"),
                reason: "its world transform cannot be inverted (a scale of zero, or values that \
                         are not finite), so a position in space cannot be written back: give \
                         the node and its parents a regular transform"
                    .to_owned(),
            })?;
            placed.push(Placed { mesh, transform });
        }
    }
    Ok(placed)
}

/// Whether each node is the child of a node; an error when it is the child of two.
fn single_parents(document: &Document) -> Result<Vec<bool>, FormatError> {
    let mut is_child = vec![false; document.nodes.len()];
    for (parent, node) in document.nodes.iter().enumerate() {
        for (position, &child) in node.children.iter().enumerate() {
            let path = || format!("nodes[{parent}].children[{position}]");
            match is_child.get_mut(child) {
                None => return Err(malformed(path(), format!("nodes[{child}] does not exist"))),
                Some(true) => {
                    return Err(malformed(path(), format!("nodes[{child}] has two parents")));
                }
                Some(slot) if child != parent => *slot = true,
                Some(_) => return Err(malformed(path(), "the node is its own child")),
            }
        }
    }
    Ok(is_child)
}

fn roots(document: &Document, is_child: &[bool]) -> Result<Vec<usize>, FormatError> {
    let index = document.scene.unwrap_or(0);
    let Some(scene) = document.scenes.get(index) else {
        if document.scene.is_none() {
            return Ok((0..is_child.len()).filter(|&n| is_child.get(n) == Some(&false)).collect());
        }
        return Err(malformed("scene", format!("scenes[{index}] does not exist")));
    };
    let mut listed = HashSet::new();
    for (position, &root) in scene.nodes.iter().enumerate() {
        let path = || format!("scenes[{index}].nodes[{position}]");
        match is_child.get(root) {
            None => return Err(malformed(path(), format!("nodes[{root}] does not exist"))),
            Some(true) => {
                return Err(malformed(
                    path(),
                    format!("nodes[{root}] is the child of another node, not a root"),
                ));
            }
            Some(false) if !listed.insert(root) => {
                return Err(malformed(path(), format!("nodes[{root}] is listed twice")));
            }
            Some(false) => {}
        }
    }
    Ok(scene.nodes.clone())
}

fn local(node: &Node, index: usize) -> Result<DAffine3, FormatError> {
    if let Some(matrix) = &node.matrix {
        let matrix = DMat4::from_cols_array(matrix.as_ref());
        let bottom = matrix.row(3);
        if !(bottom - glam::DVec4::W).abs().cmple(glam::DVec4::splat(1e-6)).all() {
            return Err(malformed(
                format!("nodes[{index}].matrix"),
                "the last row must be 0, 0, 0, 1 (matrices are written column by column)",
            ));
        }
        return Ok(DAffine3::from_mat4(matrix));
    }
    Ok(DAffine3::from_scale_rotation_translation(
        DVec3::from_array(node.scale.as_deref().copied().unwrap_or([1.0; 3])),
        DQuat::from_array(node.rotation.as_deref().copied().unwrap_or([0.0, 0.0, 0.0, 1.0])),
        DVec3::from_array(node.translation.as_deref().copied().unwrap_or([0.0; 3])),
    ))
}

#[cfg(test)]
mod tests {
    use super::super::document::parse;
    use super::*;

    fn meshes(rest: &str) -> Result<Vec<usize>, FormatError> {
        let meshes = r#""meshes":[{},{},{}]"#;
        let json = format!(r#"{{"asset":{{"version":"2.0"}},{meshes}{rest}}}"#);
        let document = parse(json.as_bytes())?;
        Ok(placed_meshes(&document)?.into_iter().map(|placed| placed.mesh).collect())
    }

    #[test]
    fn traversal_order() {
        for (rest, expected) in [
            ("", &[0, 1, 2][..]),
            (r#","nodes":[{"mesh":2},{"mesh":0,"children":[0]}]"#, &[0, 2]),
            (
                r#","nodes":[{"mesh":2},{"mesh":2},{"mesh":1}],"scenes":[{"nodes":[2,1,0]}]"#,
                &[1, 2],
            ),
            (
                r#","nodes":[{"mesh":2},{"mesh":1}],"scenes":[{"nodes":[0]},{"nodes":[1]}],"scene":1"#,
                &[1],
            ),
            (
                r#","nodes":[{"children":[1,3]},{"mesh":1,"children":[2]},{"mesh":0},{"mesh":2}],"scenes":[{"nodes":[0]}]"#,
                &[1, 0, 2],
            ),
            (r#","nodes":[{"mesh":2}],"scenes":[{}]"#, &[]),
        ] {
            assert_eq!(meshes(rest).unwrap(), expected, "{rest}");
        }
    }

    #[test]
    fn hostile_graphs_are_errors_with_a_path() {
        for (rest, expected) in [
            (r#","nodes":[{"children":[0]}]"#, "nodes[0].children[0]"),
            (
                r#","nodes":[{"children":[1]},{"children":[0]}],"scenes":[{"nodes":[0]}]"#,
                "scenes[0].nodes[0]",
            ),
            (r#","nodes":[{"children":[2]},{"children":[2]},{}]"#, "nodes[1].children[0]"),
            (r#","nodes":[{"children":[7]}]"#, "nodes[0].children[0]"),
            (r#","nodes":[{"mesh":7}]"#, "nodes[0].mesh"),
            (r#","nodes":[{}],"scenes":[{"nodes":[0,0]}]"#, "scenes[0].nodes[1]"),
            (r#","scenes":[{"nodes":[0]}]"#, "scenes[0].nodes[0]"),
            (r#","scenes":[{}],"scene":1"#, "scene"),
            (
                r#","nodes":[{"mesh":0,"matrix":[1,0,0,1,0,1,0,0,0,0,1,0,0,0,0,1]}]"#,
                "nodes[0].matrix",
            ),
            (r#","nodes":[{"mesh":0,"scale":[1,0,1]}]"#, "nodes[0]"),
            (r#","nodes":[{"mesh":0,"matrix":[1,2,3]}]"#, "nodes[0].matrix"),
        ] {
            match meshes(rest) {
                Err(
                    FormatError::MalformedGltf { path, .. } | FormatError::CannotPatch { path, .. },
                ) => {
                    assert_eq!(path, expected, "{rest}");
                }
                other => panic!("{rest}: {other:?}"),
            }
        }
    }

    #[test]
    fn a_skinned_mesh_ignores_its_node() {
        let json = r#"{"asset":{"version":"2.0"},"meshes":[{}],"nodes":[
            {"scale":[2,2,2],"children":[1]},{"mesh":0,"skin":0},{"mesh":0,"scale":[0,0,0]}]}"#;
        let document = parse(json.as_bytes()).unwrap();
        let placed = placed_meshes(&document).unwrap();
        assert_eq!(placed.len(), 1);
        assert_eq!(placed[0].transform.forward([1.0, 2.0, 3.0]), DVec3::new(1.0, 2.0, 3.0));
    }
}
