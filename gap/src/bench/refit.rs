//! What a search found, fitted again without the runs that are held out.

use files::dataset::Manifest;

use super::Explained;
use super::data::Data;
use super::model::Point;
use super::search::{Search, Set};
use super::split::Split;

/// The joint in the states that the figures compare.
pub(super) struct Points {
    /// Without a cause.
    pub(super) bare: Point,
    /// With the causes.
    pub(super) best: Point,
    /// Without each cause.
    pub(super) without: Vec<Point>,
    /// With each cause alone.
    pub(super) alone: Vec<Point>,
    /// After each step of the search.
    pub(super) steps: Vec<Point>,
}

impl Explained<'_> {
    /// The states with sizes of the runs of `split` that are fitted. The causes are those of all runs. Of a search that
    /// was ended they are as it left them.
    pub(super) fn refitted(&self, manifest: &Manifest, split: &Split) -> Points {
        let best = &self.found.best;
        if self.data.stop.asked() {
            let here = best.fit.point();
            return Points {
                bare: self.bare.fit.point(),
                best: here,
                without: self.found.without.clone(),
                alone: vec![here; best.members.len()],
                steps: self.found.steps.iter().map(|s| s.point).collect(),
            };
        }
        let (manifest, recordings) = split.fitted(manifest, &self.recordings);
        let data = Data::new(&manifest, &recordings, self.data.stop);
        match data.map(|d| d.over(self.data.horizon_s())) {
            Some(data) => {
                let (search, _) = self.search.around(&data, best);
                self.points(&search, &data)
            }
            None => self.points(&self.search, &self.data),
        }
    }

    fn points(&self, search: &Search<'_>, data: &Data<'_>) -> Points {
        let best: &Set = &self.found.best;
        let [bare, here] = [&self.bare, best].map(|s| s.fit.point());
        let each = 0..best.members.len();
        let without = each.clone().map(|i| {
            let mut members = best.members.clone();
            members.remove(i);
            let start = self.found.without.get(i).unwrap_or(&here);
            search.point(data, members, start)
        });
        let alone = each.map(|i| {
            let own = best.members[i];
            let mut start = bare;
            for axis in search.hypotheses[own].axes() {
                start.set(axis, here.get(axis));
            }
            search.point(data, vec![own], &start)
        });
        let steps = self.found.steps.iter();
        Points {
            bare: search.point(data, Vec::new(), &bare),
            best: search.point(data, best.members.clone(), &here),
            without: without.collect(),
            alone: alone.collect(),
            steps: steps
                .map(|s| search.point(data, s.members.clone(), &s.point))
                .collect(),
        }
    }
}
