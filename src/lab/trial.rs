//! One trial: a mark under a random key, and what is left of it after each attack.

use std::collections::BTreeSet;

use super::grid::Setting;
use super::measures::{Damage, Detection, damage, detect};
use super::perceived::msdm2;
use super::row::Row;
use super::run::Subject;
use crate::attacks::random::Random;
use crate::attacks::{Attack, Context, Target};
use crate::formats::{Asset, Limits};
use crate::marking::{
    Amplitude, MarkError, MarkReport, MarkRequest, MaxDistortion, mark, mark_within,
};
use crate::mesh::Mesh;
use crate::mesh::stop::Stop;
use crate::mesh::surface::Surface;
use crate::recognition::{SuspectModel, relief_of};
use crate::registration::{Budget, WorkLimits};
use crate::watermark::{Codeword, EmbedParams, Frame, MarkKey, Message, WatermarkError};

/// The parameters of a trial.
#[derive(Clone, Copy)]
pub struct Trial<'a> {
    /// The experiment's name.
    pub experiment: &'static str,
    /// The host.
    pub subject: &'a Subject,
    /// Index of the subject.
    pub number: usize,
    /// How it is marked.
    pub setting: Setting,
    /// The attacks on the mark.
    pub attacks: &'a [Attack],
    /// Families of the attacks that are made; empty for all. Seeds depend on the positions in
    /// `attacks`, which the other attacks keep.
    pub families: &'a [String],
    /// Attacks that have rows already, by their names in rows.
    pub known: Option<&'a BTreeSet<&'a str>>,
    /// Number of this trial.
    pub trial: usize,
    /// Seed of the whole run.
    pub seed: u64,
    /// Whether the distance of the attacked meshes from the host is measured. Measuring takes long,
    /// and the distance hardly differs between marks.
    pub damage: bool,
}

/// A marked mesh and its key.
pub struct MarkedMesh {
    /// As read from the marked file.
    pub mesh: Mesh,
    /// The codeword that a detector scores.
    pub codeword: Codeword,
    /// The key that its relief is drawn from.
    pub key: MarkKey,
    /// The host's frame.
    pub frame: Frame,
    /// What the embedding reached.
    pub report: MarkReport,
}

impl Trial<'_> {
    /// Marks, attacks, reads. One row per attack; `None` if `stop` returns `true` before the end.
    pub fn run(&self, stop: &(dyn Fn() -> bool + Sync)) -> Option<Vec<Row>> {
        let marked = self.mark(stop);
        if stop() {
            return None;
        }
        let marked = match marked {
            Ok(marked) => marked,
            Err(error) => {
                // A refused mark gives the same error for every attack.
                let refused = |attack| Row { error: Some(error.to_string()), ..self.blank(attack) };
                return Some(self.met().map(|(_, attack)| refused(attack)).collect());
            }
        };
        let perceived = self.perceived(&marked.mesh);
        let target = Target::new(&marked.mesh);
        let mut rows = Vec::with_capacity(self.attacks.len());
        for (place, attack) in self.met() {
            if stop() {
                return None;
            }
            let row = self.attacked((&marked, &target), (attack, place), stop);
            if stop() {
                return None;
            }
            rows.push(Row { mark_perceived: perceived, ..row });
        }
        Some(rows)
    }

    /// The attacks that are made, with their positions in the list.
    pub fn met(&self) -> impl Iterator<Item = (u64, Attack)> + '_ {
        let wanted = |attack: &Attack| {
            let asked = || self.families.iter().any(|f| f == attack.family());
            let known = |known: &BTreeSet<&str>| known.contains(attack.to_string().as_str());
            (self.families.is_empty() || asked()) && !self.known.is_some_and(known)
        };
        (0..)
            .zip(self.attacks)
            .map(|(place, &attack)| (place, attack))
            .filter(move |(_, a)| wanted(a))
    }

    /// A text that trials share if they have the same attacks and differ only in their budgets;
    /// `None` without a budget.
    pub(super) fn but_for_budget(&self) -> Option<String> {
        self.setting.budget?;
        let setting = Setting { budget: None, ..self.setting };
        Some(format!("{} {setting:?} {:?}", self.number, self.attacks))
    }

    /// The rows of this trial, if it makes the same mark as the trial with a larger budget whose
    /// rows are given. The search for the strongest mark begins at the setting's strength, which is
    /// also the largest allowed. It ends there if that mark stays within the budget.
    pub(super) fn of_larger_budget(&self, rows: &[Row]) -> Option<Vec<Row>> {
        let budget = self.setting.budget?;
        let strongest = |row: &Row| {
            row.strength_used == Some(self.setting.strength.get())
                && row.mark_mrms.is_some_and(|mrms| mrms <= budget)
        };
        let attacks = self.met().map(|(_, attack)| attack.to_string());
        let same = rows.iter().all(strongest) && attacks.eq(rows.iter().map(|r| r.attack.clone()));
        let experiment = || self.experiment.to_owned();
        let own = |row: &Row| Row { experiment: experiment(), budget: Some(budget), ..row.clone() };
        same.then(|| rows.iter().map(own).collect())
    }

    /// Key and message depend on seed, host and trial alone, so that settings are compared on equal
    /// terms.
    fn key_and_message(&self) -> Result<(MarkKey, Message), WatermarkError> {
        let mut random = self.random(0);
        let key = MarkKey::from_bytes(random.bytes());
        let bits = (0..self.setting.bits.get()).map(|_| random.word() & 1 == 1).collect();
        Ok((key, Message::from_bits(bits)?))
    }

    fn random(&self, purpose: u64) -> Random {
        let [number, trial] =
            [self.number, self.trial].map(|n| u64::try_from(n).unwrap_or(u64::MAX));
        Random::derived(self.seed, [number, trial, purpose])
    }

    fn params(&self) -> EmbedParams {
        let Setting { method, strength, bits, closed_loop, .. } = self.setting;
        EmbedParams { method, strength, bits, closed_loop }
    }

    /// Makes the mark.
    ///
    /// # Errors
    /// [`MarkError`], when the mesh does not carry it or the budget cannot be kept.
    pub fn mark(&self, stop: &(dyn Fn() -> bool + Sync)) -> Result<MarkedMesh, MarkError> {
        let (key, message) = self.key_and_message()?;
        let limits = Limits { max_bytes: usize::MAX, ..Limits::default() };
        let params = self.params();
        let independent_check_max_bytes = 0;
        let request = MarkRequest {
            key: &key,
            others: &[],
            message: &message,
            params,
            limits,
            stop,
            layers: self.setting.layers,
            amplitude: Amplitude::default(),
            independent_check_max_bytes,
        };
        let host = &self.subject.bytes;
        let marked = match self.setting.budget.and_then(|most| MaxDistortion::new(most).ok()) {
            None => mark(host, &request)?,
            Some(most) => mark_within(host, &request, most, params.strength)?,
        };
        Ok(MarkedMesh {
            mesh: Asset::read(&marked.bytes, &limits)?.into_mesh(),
            codeword: Codeword::new(&key, &message),
            key,
            frame: marked.host_frame,
            report: marked.report,
        })
    }

    /// Applies an attack to a marked mesh, which is the target. `place` is the attack's position in
    /// the list.
    ///
    /// # Errors
    /// A text, when the attack gives no mesh.
    pub fn attack(
        &self,
        report: &MarkReport,
        target: &Target<'_>,
        attack: Attack,
        place: u64,
    ) -> Result<Mesh, String> {
        let params = EmbedParams { strength: report.strength, ..self.params() };
        let (host, amplitude) = (self.subject.asset.mesh(), report.amplitude);
        let context = Context { host, params: &params, amplitude };
        let seed = self.random(1 + place).word();
        attack.apply(target, &context, seed).map_err(|error| error.to_string())
    }

    fn attacked(
        &self,
        (marked, target): (&MarkedMesh, &Target<'_>),
        (attack, place): (Attack, u64),
        stop: Stop<'_>,
    ) -> Row {
        let row = self.described(marked, attack);
        let attacked = match self.attack(&marked.report, target, attack, place) {
            Ok(attacked) => attacked,
            Err(error) => return Row { error: Some(error), ..row },
        };
        let modulation = self.setting.method.modulation();
        let measured = self.damage && attack != Attack::Similarity;
        let damage = measured.then(|| damage(self.subject.measured()?, &attacked)).flatten();
        let row = match detect(&attacked, &marked.codeword, modulation, &marked.frame) {
            Ok(found) => filled(row, &found, damage),
            Err(error) => return Row { error: Some(error.to_string()), ..row },
        };
        Row { log10_bound_relief: self.relief_of(marked, &attacked, stop), ..row }
    }

    /// The bound of the relief of an attacked mesh, read against the host as a verification reads
    /// it.
    fn relief_of(&self, marked: &MarkedMesh, attacked: &Mesh, stop: Stop<'_>) -> Option<f64> {
        let amplitude = marked.report.amplitude?;
        let surface = Surface::new(attacked);
        let suspect_model = SuspectModel::new(attacked, &surface);
        let budget = Budget::new(u64::MAX);
        let within = WorkLimits { budget: &budget, stop };
        let found =
            relief_of(self.subject.host_model(), &suspect_model, &marked.key, amplitude, within);
        found.map(|found| found.log10_fp)
    }

    /// How visible the mark is. It is measured in the first trial only, since it takes long and
    /// hardly differs.
    fn perceived(&self, mesh: &Mesh) -> Option<f64> {
        let measured = (self.trial == 0).then(|| msdm2(&self.subject.surface, &Surface::new(mesh)));
        measured.flatten()
    }

    fn described(&self, marked: &MarkedMesh, attack: Attack) -> Row {
        let report = &marked.report;
        Row {
            method_used: Some(report.method_used.name().to_owned()),
            strength_used: Some(report.strength.get()),
            mark_mrms: Some(report.quality.mrms),
            mark_hausdorff: Some(report.quality.hausdorff),
            mark_normal_deviation: Some(report.quality.normal_deviation_degrees),
            mark_flipped: Some(report.quality.flipped),
            ..self.blank(attack)
        }
    }

    /// A row without results.
    #[must_use]
    pub fn blank(&self, attack: Attack) -> Row {
        let mesh = self.subject.asset.mesh();
        Row {
            experiment: self.experiment.to_owned(),
            mesh: self.subject.name.clone(),
            vertices: mesh.positions().len(),
            triangles: mesh.triangles().len(),
            diagonal: self.subject.surface.diagonal(),
            method: self.setting.method.name().to_owned(),
            strength: self.setting.strength.get(),
            bits: self.setting.bits.get(),
            closed_loop: self.setting.closed_loop,
            budget: self.setting.budget,
            trial: self.trial,
            seed: Some(self.seed),
            place: Some(self.number),
            attack: attack.to_string(),
            family: attack.family().to_owned(),
            amount: attack.amount(),
            method_used: None,
            strength_used: None,
            mark_mrms: None,
            mark_hausdorff: None,
            mark_normal_deviation: None,
            mark_flipped: None,
            mark_perceived: None,
            bits_right: None,
            bits_wrong: None,
            bits_erased: None,
            detection_ratio: None,
            log10_bound: None,
            log10_bound_in_place: None,
            log10_bound_relief: None,
            attacked_mrms: None,
            attacked_hausdorff: None,
            error: None,
        }
    }
}

fn filled(row: Row, found: &Detection, damage: Option<Damage>) -> Row {
    Row {
        bits_right: Some(found.right),
        bits_wrong: Some(found.wrong),
        bits_erased: Some(found.erased),
        detection_ratio: Some(found.right as f64 / row.bits as f64),
        log10_bound: Some(found.log10_bound),
        log10_bound_in_place: Some(found.log10_bound_in_place),
        attacked_mrms: damage.map(|d| d.mrms),
        attacked_hausdorff: damage.map(|d| d.hausdorff),
        ..row
    }
}
