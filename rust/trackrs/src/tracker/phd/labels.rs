//! Whose a component is, and from when to when that is a track.
//!
//! 1. Targets are extracted from the heaviest component to the lightest; a component of weight w stands for ⌊w + ½⌋, or for its
//!    part of the likeliest number where that is known (CPHD).
//! 2. Each gets the component's label; where a heavier one has it already, or for a second copy, another label that was merged
//!    into the component, and if all of these are taken a new one.
//! 3. A component with several copies is divided into them, equal weights, so that from now on each has its own label.
//! 4. A label is a confirmed track from its `confirm_after`-th extraction on, and none any more after `end_after` scans without.
//!
//! Reference: extended-target spec 10; Panta, Clark, Vo (2009), Data association and track management for the Gaussian
//! mixture probability hypothesis density filter, IEEE TAES 45(3).

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::iter::repeat_n;

use serde::{Deserialize, Serialize};

use super::config::Confirmation;
use crate::error::{Result, require_count};
use crate::rfs::mixture::{Component, Merged};
use crate::rfs::prediction::fresh;
use crate::track::Track;

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Candidate {
    /// Identity, once it is confirmed.
    id: Option<u64>,
    extractions: u64,
    misses: u32,
}

/// The labels that were extracted lately.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Labels {
    candidates: BTreeMap<u64, Candidate>,
    tracks: u64,
    pub(super) next_label: u64,
    /// Those in the mixture of which it was told that steps are done by roots.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    rooted: BTreeSet<u64>,
}

impl Labels {
    /// Ends all tracks; identities are not given again.
    pub(super) fn forget(&mut self) {
        self.candidates.clear();
        self.rooted.clear();
    }

    /// The identities, none while tentative, of the targets of the last extraction of which steps were done by roots; of every
    /// label once.
    pub(super) fn newly_rooted(&mut self, mixture: &[Component]) -> Vec<Option<u64>> {
        if !self.rooted.is_empty() {
            let there: HashSet<u64> = mixture.iter().map(|component| component.label).collect();
            self.rooted.retain(|label| there.contains(label));
        }
        let mut told = Vec::new();
        for component in mixture.iter().filter(|component| component.rooted) {
            let candidate = self.candidates.get(&component.label);
            if let Some(candidate) = candidate.filter(|candidate| candidate.misses == 0)
                && self.rooted.insert(component.label)
            {
                told.push(candidate.id);
            }
        }
        told
    }

    /// Checks what was read back.
    pub(super) fn check_restored(&self) -> Result<()> {
        require_count("tracks", self.tracks)?;
        require_count("labels", self.next_label)?;
        let mut extractions = self.candidates.values().map(|candidate| candidate.extractions);
        extractions.try_for_each(|count| require_count("reports of a track", count))
    }
}

/// A mixture with one component for every extracted target, and the confirmed tracks.
pub(super) struct Extraction {
    pub(super) mixture: Vec<Component>,
    pub(super) tracks: Vec<Track>,
}

impl Labels {
    /// Extracts so many targets from every component of a reduced mixture.
    pub(super) fn extract(
        &mut self,
        merged: Vec<Merged>,
        copies: &[usize],
        time: f64,
        rule: Confirmation,
    ) -> Extraction {
        let mut order: Vec<usize> = (0..merged.len()).collect();
        order.sort_by(|&a, &b| merged[b].component.weight.total_cmp(&merged[a].component.weight));
        let mut names: Vec<Vec<u64>> = vec![Vec::new(); merged.len()];
        let mut taken = HashSet::new();
        for &i in &order {
            let mut free = merged[i].labels.iter().copied();
            for _ in 0..copies[i] {
                let label = free
                    .by_ref()
                    .find(|label| !taken.contains(label))
                    .unwrap_or_else(|| fresh(&mut self.next_label));
                taken.insert(label);
                names[i].push(label);
            }
        }
        let mut mixture = Vec::with_capacity(merged.len());
        let mut tracks = Vec::new();
        for (Merged { component, .. }, names) in merged.into_iter().zip(names) {
            if names.is_empty() {
                mixture.push(component);
                continue;
            }
            let weight = component.weight / names.len() as f64;
            for (copy, label) in repeat_n(component, names.len()).zip(names) {
                let copy = Component { weight, label, ..copy };
                tracks.extend(self.extracted(&copy, time, rule));
                mixture.push(copy);
            }
        }
        self.candidates.retain(|label, candidate| {
            if !taken.contains(label) {
                candidate.misses = candidate.misses.saturating_add(1);
            }
            candidate.misses < rule.end_after
        });
        tracks.sort_by_key(|track| track.id);
        Extraction { mixture, tracks }
    }

    fn extracted(&mut self, target: &Component, time: f64, rule: Confirmation) -> Option<Track> {
        let candidate = self.candidates.entry(target.label).or_insert(Candidate {
            id: None,
            extractions: 0,
            misses: 0,
        });
        candidate.extractions += 1;
        candidate.misses = 0;
        if candidate.id.is_none() && candidate.extractions >= u64::from(rule.confirm_after) {
            self.tracks += 1;
            candidate.id = Some(self.tracks);
        }
        candidate.id.map(|id| Track {
            id,
            time,
            state: target.state.clone(),
            last_hit: time,
            hits: candidate.extractions,
            existence: Some(target.weight.min(1.0)),
            extent: target.extent.clone(),
            health: None,
        })
    }
}
