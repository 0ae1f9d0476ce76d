//! Whether rows of earlier runs can be reported together with the rows of this run. Keys and
//! messages depend on the seed and on a host's position among the files, and a report treats all
//! its rows as one run.

use std::collections::BTreeMap;

use super::row::Row;
use super::run::{Plan, Subject};

/// Why rows cannot belong to a plan.
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
    /// Their host had another position among the files.
    #[error(
        "{mesh} was file {theirs} of the run that the rows are of, and is file {ours} now: name the \
         files in the same order, on which keys depend"
    )]
    Place {
        /// The host.
        mesh: String,
        /// Its position then, from 1.
        theirs: usize,
        /// Its position now, from 1.
        ours: usize,
    },
    /// Their host has the same name and is another mesh.
    #[error("the rows of {mesh} are of another mesh of that name: {theirs} there, {ours} here")]
    Host {
        /// The host.
        mesh: String,
        /// Vertices, triangles and diagonal of the rows' mesh.
        theirs: String,
        /// Those of the file.
        ours: String,
    },
    /// Their host is one of the files under another name.
    #[error(
        "the rows call file {place} {theirs}, and it is called {ours} now: give it its name of then"
    )]
    Name {
        /// Its position, from 1.
        place: usize,
        /// Its name then.
        theirs: String,
        /// Its name now.
        ours: String,
    },
    /// They are of two runs that named their files in different orders.
    #[error(
        "{mesh} was file {first} of one run that the rows are of and file {second} of another: report \
         them one by one"
    )]
    Mixed {
        /// The host.
        mesh: String,
        /// Its position in the one run, from 1.
        first: usize,
        /// Its position in the other, from 1.
        second: usize,
    },
}

/// What identifies a mesh.
#[derive(Clone, Copy)]
struct Identity {
    vertices: usize,
    triangles: usize,
    diagonal: f64,
}

impl Identity {
    fn of_row(row: &Row) -> Self {
        Self { vertices: row.vertices, triangles: row.triangles, diagonal: row.diagonal }
    }

    fn of_host(subject: &Subject) -> Self {
        let mesh = subject.asset.mesh();
        let [vertices, triangles] = [mesh.positions().len(), mesh.triangles().len()];
        Self { vertices, triangles, diagonal: subject.surface.diagonal() }
    }

    fn is(self, other: Self) -> bool {
        // Writing and reading does not change a number, but another release may sum it differently.
        let alike = (self.diagonal - other.diagonal).abs() <= 1e-9 * self.diagonal.abs();
        self.vertices == other.vertices && self.triangles == other.triangles && alike
    }

    /// # Errors
    /// [`Stranger::Host`], when `other` is another mesh.
    fn must_be(self, other: Self, mesh: &str) -> Result<(), Stranger> {
        if self.is(other) {
            return Ok(());
        }
        let said = |Self { vertices, triangles, diagonal }| {
            format!("{vertices} vertices, {triangles} triangles, diagonal {diagonal}")
        };
        Err(Stranger::Host { mesh: mesh.to_owned(), theirs: said(self), ours: said(other) })
    }
}

/// What the rows of one host say about it.
struct Told {
    identity: Identity,
    /// Its position among the files, if any row has it.
    place: Option<usize>,
}

impl Plan<'_> {
    /// Checks that the known rows can belong to this plan. Rows of earlier versions have neither
    /// seed nor position, and are not checked for them.
    ///
    /// # Errors
    /// [`Stranger`], for the first row that cannot.
    pub fn check_known(&self) -> Result<(), Stranger> {
        let mut hosts: BTreeMap<&str, Told> = BTreeMap::new();
        for row in self.known {
            if let Some(theirs) = row.seed.filter(|&seed| seed != self.seed) {
                return Err(Stranger::Seed { mesh: row.mesh.clone(), theirs, ours: self.seed });
            }
            let identity = Identity::of_row(row);
            let told = hosts.entry(&row.mesh).or_insert(Told { identity, place: row.place });
            identity.must_be(told.identity, &row.mesh)?;
            match (told.place, row.place) {
                (Some(one), Some(other)) if one != other => {
                    let [first, second] = [one, other].map(from_1);
                    return Err(Stranger::Mixed { mesh: row.mesh.clone(), first, second });
                }
                (known, new) => told.place = known.or(new),
            }
        }
        hosts.into_iter().try_for_each(|(mesh, told)| self.check_host(mesh, &told))
    }

    /// Checks that a host of the rows is the file of that name, at the same position.
    fn check_host(&self, mesh: &str, told: &Told) -> Result<(), Stranger> {
        let mut files = self.subjects.iter().enumerate();
        if let Some((own, subject)) = files.find(|(_, subject)| subject.name == mesh) {
            told.identity.must_be(Identity::of_host(subject), mesh)?;
            return match told.place.filter(|&place| place != own) {
                None => Ok(()),
                Some(place) => {
                    let [theirs, ours] = [place, own].map(from_1);
                    Err(Stranger::Place { mesh: mesh.to_owned(), theirs, ours })
                }
            };
        }
        let there = told.place.and_then(|place| Some((place, self.subjects.get(place)?)));
        match there.filter(|(_, subject)| told.identity.is(Identity::of_host(subject))) {
            None => Ok(()),
            Some((place, subject)) => Err(Stranger::Name {
                place: from_1(place),
                theirs: mesh.to_owned(),
                ours: subject.name.clone(),
            }),
        }
    }
}

/// A position counted from 1. It does not overflow, whatever a file says.
fn from_1(place: usize) -> usize {
    place.saturating_add(1)
}
