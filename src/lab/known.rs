//! Rows of earlier runs, and whether they can be rows of this one: keys and messages depend on the
//! seed and on a host's place among the files, and rows of others beside this run's would be told of
//! as one experiment.

use super::run::{Plan, Subject};

/// Why rows cannot be of a plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Stranger {
    /// They come from another seed.
    #[error("the rows of {mesh} are of seed {theirs}, this run's is {ours}: give --seed {theirs}")]
    Seed {
        /// The host.
        mesh: String,
        /// Seed of the rows.
        theirs: u64,
        /// Seed of the plan.
        ours: u64,
    },
    /// Their host was another one of the files.
    #[error(
        "{mesh} was file {theirs} of the run that the rows are of, and is file {ours} now: name the \
         files in the same order, on which keys depend"
    )]
    Place {
        /// The host.
        mesh: String,
        /// Its place then, from 1.
        theirs: usize,
        /// Its place now, from 1.
        ours: usize,
    },
    /// Their host has the same name and is another mesh.
    #[error(
        "the rows of {mesh} are of a mesh of {theirs} vertices and triangles, this file has {ours}: \
         it is another mesh of the same name"
    )]
    Host {
        /// The host.
        mesh: String,
        /// Vertices and triangles of the rows' mesh.
        theirs: String,
        /// Those of the file.
        ours: String,
    },
}

impl Plan<'_> {
    /// Whether the known rows can be of this plan, as far as they tell: those of other hosts can, and
    /// those without a seed or a place, which earlier versions wrote.
    ///
    /// # Errors
    /// [`Stranger`], by the first row that cannot.
    pub fn check_known(&self) -> Result<(), Stranger> {
        for row in self.known {
            let own = |(_, subject): &(usize, &Subject)| subject.name == row.mesh;
            let mut hosts = self.subjects.iter().enumerate().filter(own).peekable();
            let mesh = || row.mesh.clone();
            let Some(&(first, subject)) = hosts.peek() else { continue };
            if let Some(theirs) = row.seed.filter(|&seed| seed != self.seed) {
                return Err(Stranger::Seed { mesh: mesh(), theirs, ours: self.seed });
            }
            if let Some(place) = row.place.filter(|place| hosts.all(|(own, _)| own != *place)) {
                return Err(Stranger::Place { mesh: mesh(), theirs: place + 1, ours: first + 1 });
            }
            let counts = |vertices, triangles| format!("{vertices} and {triangles}");
            let theirs = counts(row.vertices, row.triangles);
            let host = subject.asset.mesh();
            let ours = counts(host.positions().len(), host.triangles().len());
            if theirs != ours {
                return Err(Stranger::Host { mesh: mesh(), theirs, ours });
            }
        }
        Ok(())
    }
}
