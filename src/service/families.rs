//! Families of hosts: a marked file that was marked again as a host, and the host it came from.
//!
//! The sketch of such a host depends on the mark that it carried. Were it listed for itself, then where
//! the older host stands on a short list, or whether it stands there at all, would depend on the
//! codewords of its own records: how often its parts are shared, who comes before whom, who is cut off.
//! But the share of the error probability of a record may not depend on its codeword. So a family takes
//! its place by one sketch, that of its eldest host, which carries no mark of the family, and all its
//! members are looked at there, in order of registration, each with a fixed share of the family's
//! (`verify::shortlist`). A host that carries marks of several families is in that of the eldest host.
//!
//! Who descends from whom is what records say of the marks that their hosts carried. Must not know how
//! hosts are compared.

use std::collections::HashMap;

use super::hosts::HostKey;

/// Hosts that are there, in order of registration, and what they descend from.
#[derive(Debug, Default)]
pub(super) struct Families {
    /// Which host came how early.
    order: HashMap<HostKey, u64>,
    next: u64,
    /// Hosts whose marks a host carried, there or not.
    parents: HashMap<HostKey, Vec<HostKey>>,
}

impl Families {
    /// Notes that one descends from another.
    pub(super) fn descends(&mut self, host: HostKey, from: HostKey) {
        let parents = self.parents.entry(host).or_default();
        if host != from && !parents.contains(&from) {
            parents.push(from);
        }
    }

    /// Adds a host, after all that are there.
    pub(super) fn insert(&mut self, host: HostKey) {
        if !self.order.contains_key(&host) {
            self.order.insert(host, self.next);
            self.next += 1;
        }
    }

    /// Takes a host out. Who descends from it descends from its parents all the same.
    pub(super) fn remove(&mut self, host: HostKey) {
        self.order.remove(&host);
    }

    /// Where a host stands in the order of registration.
    pub(super) fn place(&self, host: HostKey) -> u64 {
        self.order.get(&host).copied().unwrap_or(u64::MAX)
    }

    /// The eldest of those that are there which a host descends from; itself where there is none.
    pub(super) fn eldest(&self, host: HostKey) -> HostKey {
        let (mut seen, mut at) = (vec![host], 0);
        while let Some(next) = seen.get(at) {
            for parent in self.parents.get(next).into_iter().flatten() {
                if !seen.contains(parent) {
                    seen.push(*parent);
                }
            }
            at += 1;
        }
        seen.into_iter().min_by_key(|&host| self.place(host)).unwrap_or(host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(k: u8) -> HostKey {
        HostKey::new(&[k; 32])
    }

    #[test]
    fn a_family_is_called_by_its_eldest_host_that_is_there() {
        let mut families = Families::default();
        for host in [1, 2, 3, 4, 5] {
            families.insert(key(host));
        }
        // 3 was made of 1; 4 of 3 and 2; 2 and 5 are nobody's.
        families.descends(key(3), key(1));
        families.descends(key(4), key(2));
        families.descends(key(4), key(3));
        families.descends(key(4), key(4));
        let eldest = |families: &Families, host| families.eldest(key(host));
        for (host, expected) in [(1, 1), (2, 2), (3, 1), (4, 1), (5, 5)] {
            assert_eq!(eldest(&families, host), key(expected), "{host}");
        }
        families.remove(key(1));
        for (host, expected) in [(2, 2), (3, 3), (4, 2)] {
            assert_eq!(eldest(&families, host), key(expected), "{host}");
        }
        // Back again it is the youngest; a circle has an end.
        families.insert(key(1));
        families.descends(key(1), key(4));
        assert_eq!((eldest(&families, 3), eldest(&families, 1)), (key(2), key(2)));
    }
}
