//! Rows of earlier runs, and whether they can stand beside those of this one: keys and messages depend
//! on the seed and on a host's place among the files, and a report tells of all its rows as of one run.

use std::collections::BTreeMap;

use super::row::Row;
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
        /// Its place, from 1.
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
        /// Its place in the one run, from 1.
        first: usize,
        /// Its place in the other, from 1.
        second: usize,
    },
}

/// What a mesh is known by.
#[derive(Clone, Copy)]
struct Shape {
    vertices: usize,
    triangles: usize,
    diagonal: f64,
}

impl Shape {
    fn of_row(row: &Row) -> Self {
        Self { vertices: row.vertices, triangles: row.triangles, diagonal: row.diagonal }
    }

    fn of_host(subject: &Subject) -> Self {
        let mesh = subject.asset.mesh();
        let [vertices, triangles] = [mesh.positions().len(), mesh.triangles().len()];
        Self { vertices, triangles, diagonal: subject.surface.diagonal() }
    }

    fn is(self, other: Self) -> bool {
        // Written and read again, a number is the same; another release may sum it differently.
        let alike = (self.diagonal - other.diagonal).abs() <= 1e-9 * self.diagonal.abs();
        self.vertices == other.vertices && self.triangles == other.triangles && alike
    }

    fn said(self) -> String {
        let Self { vertices, triangles, diagonal } = self;
        format!("{vertices} vertices, {triangles} triangles, diagonal {diagonal}")
    }
}

impl Plan<'_> {
    /// Whether the known rows can be of this plan, as far as they tell: earlier versions wrote neither
    /// seed nor place.
    ///
    /// # Errors
    /// [`Stranger`], by the first row that cannot.
    pub fn check_known(&self) -> Result<(), Stranger> {
        let mut firsts: BTreeMap<&str, &Row> = BTreeMap::new();
        for row in self.known {
            let mesh = || row.mesh.clone();
            if let Some(theirs) = row.seed.filter(|&seed| seed != self.seed) {
                return Err(Stranger::Seed { mesh: mesh(), theirs, ours: self.seed });
            }
            let first = *firsts.entry(&row.mesh).or_insert(row);
            let (theirs, ours) = (Shape::of_row(row), Shape::of_row(first));
            if !theirs.is(ours) {
                let (theirs, ours) = (theirs.said(), ours.said());
                return Err(Stranger::Host { mesh: mesh(), theirs, ours });
            }
            if let (Some(one), Some(other)) = (first.place, row.place)
                && one != other
            {
                let [first, second] = [one, other].map(|place| place.saturating_add(1));
                return Err(Stranger::Mixed { mesh: mesh(), first, second });
            }
        }
        firsts.into_values().try_for_each(|row| self.check_host(row))
    }

    /// Whether the host of a row is the file of that name, at its place.
    fn check_host(&self, row: &Row) -> Result<(), Stranger> {
        let mesh = row.mesh.clone();
        let named = self.subjects.iter().position(|subject| subject.name == row.mesh);
        let theirs = Shape::of_row(row);
        if let Some((own, subject)) = named.and_then(|own| Some((own, self.subjects.get(own)?))) {
            let ours = Shape::of_host(subject);
            if !theirs.is(ours) {
                return Err(Stranger::Host { mesh, theirs: theirs.said(), ours: ours.said() });
            }
            let place = row.place.unwrap_or(own);
            let [theirs, ours] = [place, own].map(|place| place.saturating_add(1));
            return if place == own { Ok(()) } else { Err(Stranger::Place { mesh, theirs, ours }) };
        }
        let there = row.place.and_then(|place| Some((place, self.subjects.get(place)?)));
        match there.filter(|(_, subject)| theirs.is(Shape::of_host(subject))) {
            Some((place, subject)) => Err(Stranger::Name {
                place: place.saturating_add(1),
                theirs: mesh,
                ours: subject.name.clone(),
            }),
            None => Ok(()),
        }
    }
}
